"""What figures and the viewer draw alike: colours, units, which rods, and ellipsoids."""

from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.contacts import ContactKind
from vibrissa.forward import Scan
from vibrissa.inverse import Reconstruction
from vibrissa.io.sweeps import StoredSweep
from vibrissa.rod import Rod

KIND_COLOURS = {ContactKind.TIP: "#c1121f", ContactKind.TANGENTIAL: "#1d5fa8"}
"""Tip contact red, tangential contact blue (paper, figure 3)."""
KIND_NAMES = {ContactKind.TIP: "tip contact", ContactKind.TANGENTIAL: "tangential contact"}
BEHIND, FREE = "#000000", "#999999"
"""Colours of a rod behind its contact, and of a rod without contact."""
AXES_95 = 2.7955
"""Square root of the 95 % quantile of χ² with three degrees of freedom."""
_MISSED = 0.01
"""Rod lengths between clamp and line, from which on one sees that they do not meet."""


def length_unit(rod: Rod) -> str:
    """Unit in which lengths are drawn: mm, or L for a rod in the model's units."""
    return "mm" if rod.units == "SI" else "L"


def length_factor(rod: Rod) -> float:
    """Factor by which lengths are multiplied to be drawn in `length_unit`."""
    return 1e3 if rod.units == "SI" else 1.0


Swept: TypeAlias = Scan | Reconstruction | StoredSweep
"""What can be drawn of a sweep."""


class DrawnRod(NamedTuple):
    """One rod: points (p, 3), and of each piece between two of them whether it is bent."""

    line: Float[np.ndarray, "p 3"]
    bent: Bool[np.ndarray, "pieces"]
    paint: str
    """Colour of the bent pieces: that of the kind of contact."""
    rest: str
    """Colour of the others."""


def drawn_rods(
    what: Swept, rows: Bool[np.ndarray, "*trail n"], count: int
) -> Iterator[tuple[tuple[int, ...], DrawnRod]]:
    """Rods at some rows, with `count` points each, and their rows.

    A reconstruction that no rod explains has lines that are NaN or miss the clamp, by more than
    its support yields: those are left out.
    """
    s = np.linspace(0, what.rod.length, count)[:-1]
    clamps = what.reactions.trail.position
    places = list(map(tuple, np.argwhere(rows).tolist()))
    for at, line in zip(places, what.elastic_lines(rows, count), strict=True):
        kind = ContactKind(int(what.kind[at]))
        rest = FREE if kind is ContactKind.NONE else BEHIND
        bent = s < np.nan_to_num(what.arc_length[at])
        missed = np.linalg.norm(line[0] - clamps[at]) if what.rod.plain else 0.0
        if missed < _MISSED * what.rod.length and np.isfinite(line).all():
            yield at, DrawnRod(line, bent, KIND_COLOURS.get(kind, rest), rest)


def half_axes(covariance: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Half axes of the ellipsoids that hold a point with 95 %, as columns, shortest first."""
    variances, axes = np.linalg.eigh(covariance)
    return np.asarray(AXES_95 * np.sqrt(np.maximum(variances, 0))[:, None] * axes)
