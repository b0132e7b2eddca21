"""The inverse problem: support reactions in, contact points with normals and error bars out. It
never sees the object.
"""

from vibrissa.inverse.causes import ContactErrors, contact_errors
from vibrissa.inverse.checks.check import check_setup
from vibrissa.inverse.checks.findings import Cause, SetupCheck
from vibrissa.inverse.friction import FrictionEstimate, estimate_friction
from vibrissa.inverse.integration import reconstruct_by_integration
from vibrissa.inverse.reconstruct import reconstruct
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.smoothing.causal import CausalSmoother
from vibrissa.inverse.smoothing.result import LiveContact, Smoothing, Touch
from vibrissa.inverse.smoothing.smooth import smooth

__all__ = [
    "CausalSmoother",
    "Cause",
    "ContactErrors",
    "FrictionEstimate",
    "LiveContact",
    "Reconstruction",
    "SetupCheck",
    "Smoothing",
    "Touch",
    "check_setup",
    "contact_errors",
    "estimate_friction",
    "reconstruct",
    "reconstruct_by_integration",
    "smooth",
]
