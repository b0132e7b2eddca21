"""Axes around a scene, with ticks and their unit."""

import math

import numpy as np
from jaxtyping import Float

_TICKS = 7
"""Along the longest side."""


def ticked_box(
    low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], unit: str
) -> tuple[Float[np.ndarray, "n 2 3"], list[tuple[Float[np.ndarray, "3"], str]]]:
    """A floor with a grid, and three edges of a box with ticks.

    Parameters
    ----------
    low, high
        Least and largest coordinates (3,) of what the box holds.
    unit
        Of the coordinates, or "" if it is unknown.

    Returns
    -------
    tuple
        Line segments, and places with their labels.
    """
    step = tick_step(float((high - low).max()) or 1.0)
    first, last = np.floor(low / step - 1e-9), np.ceil(high / step + 1e-9)
    low, high = step * first, step * last
    ticks = [step * np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
    span = float((high - low).max())
    lines, labels = [], []
    # Where each axis runs: along the two sides of the floor in front of the eye, and up at one end.
    for axis, (corner, outwards) in enumerate(
        (
            (low, np.array([0.0, -1.0, 0.0])),
            (np.array([high[0], low[1], low[2]]), np.array([1.0, 0.0, 0.0])),
            (low, np.array([-1.0, 0.0, 0.0])),
        )
    ):
        along = np.zeros(3)
        along[axis] = 1.0
        start = np.where(along > 0, low, corner)
        lines.append([start, np.where(along > 0, high, corner)])
        across = 1 - axis if axis < 2 else None
        for value in ticks[axis]:
            place = np.where(along > 0, value, corner)
            lines.append([place, place + 0.015 * span * outwards])
            if axis < 2 or value > low[2]:  # the corner has two labels already
                text = f"{value:.6g}".replace("-", "−")
                labels.append((place + 0.05 * span * outwards, text))
            if across is not None:
                end = place.copy()
                end[across] = high[across] if across else low[across]
                lines.append([place, end])
        middle = np.where(along > 0, (low + high) / 2, corner) + 0.13 * span * outwards
        labels.append((middle, f"{'xyz'[axis]} [{unit}]" if unit else "xyz"[axis]))
    return np.array(lines), labels


def tick_step(span: float) -> float:
    """A step of 1, 2 or 5 times a power of ten that divides a span into at most seven parts."""
    power: float = 10.0 ** math.floor(math.log10(span / _TICKS))
    return next(step * power for step in (1, 2, 5, 10) if span / (step * power) <= _TICKS)
