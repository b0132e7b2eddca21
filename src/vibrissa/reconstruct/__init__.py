"""The inverse problem: support reactions in, contact points with normals and error bars out. It never sees the object."""

from vibrissa.reconstruct.causes import ContactErrors, contact_errors
from vibrissa.reconstruct.checks.check import check_setup
from vibrissa.reconstruct.checks.findings import Cause, SetupCheck
from vibrissa.reconstruct.friction import FrictionEstimate, estimate_friction
from vibrissa.reconstruct.integration import reconstruct_by_integration
from vibrissa.reconstruct.reconstruct import reconstruct
from vibrissa.reconstruct.result import Reconstruction
from vibrissa.reconstruct.smoothing.causal import CausalSmoother, LiveContact
from vibrissa.reconstruct.smoothing.result import Smoothing, Touch
from vibrissa.reconstruct.smoothing.smooth import smooth

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
