"""The inverse problem: support reactions in, contact points with normals and error bars out. It never sees the object."""

from vibrissa.reconstruct.integration import reconstruct_by_integration
from vibrissa.reconstruct.reconstruct import reconstruct
from vibrissa.reconstruct.result import Reconstruction

__all__ = ["Reconstruction", "reconstruct", "reconstruct_by_integration"]
