"""Array shapes that come up again and again."""

import numpy as np
from jaxtyping import Bool, Float

Numbers = Float[np.ndarray, "n"]
Chosen = Bool[np.ndarray, "n"]
Vectors = Float[np.ndarray, "n 3"]
Wrenches = Float[np.ndarray, "n 6"]
Unknowns = Float[np.ndarray, "unknowns"]
Information = Float[np.ndarray, "unknowns unknowns"]
Columns = Float[np.ndarray, "n 6 m"]
"""Change of all rows' readings per unit of each of m numbers."""
Square = Float[np.ndarray, "k k"]
