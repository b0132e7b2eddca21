"""Bracketed roots of many scalar functions, side by side."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

_MOST_EVALUATIONS = 80
_WIDTH = 4e-16
"""Of a bracket between two neighbouring numbers."""
_VALUE = 1e-14
"""Share of the values at the ends that is rounding."""


def roots(
    function: Callable[[Float[np.ndarray, "j"], Int[np.ndarray, "j"]], Float[np.ndarray, "j"]],
    ends: tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]],
    values: tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]],
) -> Float[np.ndarray, "k"]:
    """Where functions of (argument, row) pass zero between two ends with known values of opposite
    signs. Where rounding has left both ends of one sign, or the function is not finite on the way,
    the end that comes nearer to zero.

    Notes
    -----
    Chandrupatla's method (Adv. Eng. Softw. 28, 1997): inverse quadratic interpolation where three
    values allow it, else bisection; here begun with a secant, and with the secant through two
    points on one side of the root, which a kink at the root, as of a change of phase, does not
    mislead. SciPy's takes two to five times as many evaluations, each of them an equilibrium.
    """
    x1, x2 = (np.array(end, dtype=float) for end in ends)
    f1, f2 = (np.array(value, dtype=float) for value in values)
    nearer = np.where(np.abs(f1) <= np.abs(f2), x1, x2)
    small = _VALUE * np.maximum(np.abs(f1), np.abs(f2))
    opposite = f1 * f2 < 0
    share = f1 / np.where(opposite, f1 - f2, 1.0)
    left = np.flatnonzero(opposite)
    for _ in range(_MOST_EVALUATIONS):
        if not left.size:
            break
        x = x1[left] + share[left] * (x2[left] - x1[left])
        f = function(x, left)
        # x1 is the newest point, x2 the end of opposite sign, x3 the one that was left.
        same = f * f1[left] > 0
        x3, f3 = np.where(same, (x1[left], f1[left]), (x2[left], f2[left]))
        x2[left], f2[left] = np.where(same, (x2[left], f2[left]), (x1[left], f1[left]))
        x1[left], f1[left] = x, f
        share[left] = _share((x, x2[left], x3), (f, f2[left], f3), same)
        wide = np.abs(x2[left] - x) > _WIDTH * (1 + np.abs(x))
        left = left[wide & (np.abs(f) > small[left])]
    return np.where(opposite & np.isfinite(f1), x1, nearer)


def _share(
    x: tuple[np.ndarray, ...], f: tuple[np.ndarray, ...], same: Bool[np.ndarray, "j"]
) -> Float[np.ndarray, "j"]:
    """How far to go from the newest point to the other end: where the secant of one side, or
    inverse quadratic interpolation, leads if that is safe, else half.
    """
    (x1, x2, x3), (f1, f2, f3) = x, f
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        secant = f1 / (f3 - f1) * (x1 - x3) / (x2 - x1)
        xi, phi = (x1 - x2) / (x3 - x2), (f1 - f2) / (f3 - f2)
        quadratic = f1 / (f2 - f1) * f3 / (f2 - f3) + (x3 - x1) / (x2 - x1) * f1 / (f3 - f1) * (
            f2 / (f3 - f2)
        )
        least = _WIDTH / np.maximum(np.abs(x2 - x1), _WIDTH)
    safe = (phi * phi < xi) & ((1 - phi) ** 2 < 1 - xi) & np.isfinite(quadratic)
    share = np.where(same & (secant > 0) & (secant < 1), secant, np.where(safe, quadratic, 0.5))
    return np.clip(share, least, 1 - least)
