"""Array shapes used throughout: of one row, and of many rows (…)."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

Flag = Bool[Any, ""]
Scalar = Float[Any, ""]
Vector = Float[Any, "3"]
Frame = Float[Any, "3 3"]
Wrench = Float[Any, "6"]
"""Force and moment, or a derivative with respect to them."""
Spread = Float[Any, "6 6"]
"""Covariance of a wrench, or a linear map between wrenches."""

Flags = Bool[np.ndarray, "*trail n"]
Codes = Int[np.ndarray, "*trail n"]
Scalars = Float[np.ndarray, "*trail n"]
Vectors = Float[np.ndarray, "*trail n 3"]
Frames = Float[np.ndarray, "*trail n 3 3"]
Covariances = Frames
Wrenches = Float[np.ndarray, "*trail n 6"]
Spreads = Float[np.ndarray, "*trail n 6 6"]
