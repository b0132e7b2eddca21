"""The inverse problem: support reactions in, contact points with normals and error bars out. It never sees the object."""

from vibrissa.reconstruct.friction import FrictionEstimate, estimate_friction
from vibrissa.reconstruct.integration import reconstruct_by_integration
from vibrissa.reconstruct.reconstruct import reconstruct
from vibrissa.reconstruct.result import Reconstruction

__all__ = ["FrictionEstimate", "Reconstruction", "estimate_friction", "reconstruct", "reconstruct_by_integration"]
