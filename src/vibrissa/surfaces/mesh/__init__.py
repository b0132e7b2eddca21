"""Triangle meshes as smooth level functions: read, repaired, split at creases, sampled."""

from vibrissa.surfaces.mesh.repair import Repairs
from vibrissa.surfaces.mesh.surface import Mesh

__all__ = ["Mesh", "Repairs"]
