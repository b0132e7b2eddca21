"""`trimesh` and `igl`, and the arrays that pass between them."""

from functools import partial

import numpy as np
from jaxtyping import Float, Int

from vibrissa.libraries import extra_library

library = partial(extra_library, extra="mesh", need="meshes need it")

Vertices = Float[np.ndarray, "_ 3"]
Faces = Int[np.ndarray, "_ 3"]
