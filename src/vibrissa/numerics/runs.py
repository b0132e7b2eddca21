"""Runs of a flag."""

import numpy as np
from jaxtyping import Bool


def runs(flags: Bool[np.ndarray, "n"]) -> list[list[int]]:
    """Stretches [start, stop) in which a flag holds."""
    return np.flatnonzero(np.diff(flags, prepend=False, append=False)).reshape(-1, 2).tolist()
