"""Axes around a scene, with ticks and their unit."""

import math

import numpy as np
from jaxtyping import Float

_TICKS = 7
"""At most along the longest side."""
_TICK, _NUMBER, _NAME = 0.015, 0.05, 0.13
"""Length of a tick, and distances of its number and of the axis's name, by the longest side."""


def ticked_box(
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
    unit: str,
    towards: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "n 2 3"], list[tuple[Float[np.ndarray, "3"], str]]]:
    """A floor with a grid, and three edges of a box with ticks, where they hide nothing.

    Parameters
    ----------
    low, high
        Least and largest coordinates (3,) of what the box holds.
    unit
        Of the coordinates, or "" if it is unknown.
    towards
        Direction towards the eye (3,).

    Returns
    -------
    tuple
        Line segments, and places with their labels.
    """
    step = tick_step(float((high - low).max()) or 1.0)
    first, last = np.floor(low / step - 1e-9), np.ceil(high / step + 1e-9)
    low, high = step * first, step * last
    span = float((high - low).max())
    lines, labels = [], []
    for axis, (corner, outwards) in enumerate(_edges(low, high, towards)):
        along = np.eye(3)[axis]
        lines.append([np.where(along, low, corner), np.where(along, high, corner)])
        for value in step * np.arange(first[axis], last[axis] + 1):
            place = np.where(along, value, corner)
            lines.append([place, place + _TICK * span * outwards])
            if axis < 2:
                across = np.eye(3)[1 - axis]
                lines.append([np.where(across, low, place), np.where(across, high, place)])
            if axis < 2 or value > low[2]:  # that corner has two labels already
                text = f"{value:.6g}".replace("-", "−")
                labels.append((place + _NUMBER * span * outwards, text))
        middle = np.where(along, (low + high) / 2, corner) + _NAME * span * outwards
        labels.append((middle, f"{'xyz'[axis]} [{unit}]" if unit else "xyz"[axis]))
    return np.array(lines), labels


def _edges(
    low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], towards: Float[np.ndarray, "3"]
) -> list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:
    """Where x, y and z run, and to which side their labels lie: x and y along the sides of the
    floor in front of the eye, z at the left.
    """
    near = np.where(towards > 0, high, low)
    near[2] = low[2]
    side = np.where(towards > 0, 1.0, -1.0)
    left = np.array([towards[1], -towards[0], 0.0])
    left_corner = np.where(left > 0, high, low)
    left_corner[2] = low[2]
    # Away from the box, across the line of sight.
    left /= np.linalg.norm(left)
    return [
        (near, np.array([0.0, side[1], 0.0])),
        (near, np.array([side[0], 0.0, 0.0])),
        (left_corner, left),
    ]


def tick_step(span: float) -> float:
    """A step of 1, 2 or 5 times a power of ten that divides a span into at most seven parts."""
    power: float = 10.0 ** math.floor(math.log10(span / _TICKS))
    return next(step * power for step in (1, 2, 5, 10) if span / (step * power) <= _TICKS)
