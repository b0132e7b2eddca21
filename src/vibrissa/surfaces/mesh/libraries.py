"""`trimesh` and `igl`."""

from functools import partial

from vibrissa.libraries import extra_library

library = partial(extra_library, extra="mesh", need="meshes need it")
