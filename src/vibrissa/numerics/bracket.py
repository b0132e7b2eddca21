"""Bracketed roots of many scalar functions, side by side."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize.elementwise import find_root

_ROUNDING = 1e-16
"""Of functions of order one."""


def roots(
    function: Callable[[Float[np.ndarray, "j"], Int[np.ndarray, "j"]], Float[np.ndarray, "j"]],
    low: Float[np.ndarray, "k"],
    high: Float[np.ndarray, "k"],
) -> Float[np.ndarray, "k"]:
    """Where functions of (argument, row) pass zero between two ends: Chandrupatla's method (Adv.
    Eng. Softw. 28, 1997), SciPy's. Where rounding has left both ends of one sign, or the function
    is not finite on the way, the end that comes nearer to zero.
    """
    rows = np.arange(len(low))
    if not len(rows):
        return np.zeros(0)
    found = find_root(
        lambda at, row: function(at, row.astype(int)),
        (low, high),
        args=(rows,),
        tolerances={"fatol": _ROUNDING},
    ).x
    if np.isfinite(found).all():
        return np.asarray(found)
    first, last = (np.abs(function(end, rows)) for end in (low, high))
    return np.where(np.isfinite(found), found, np.where(first <= last, low, high))
