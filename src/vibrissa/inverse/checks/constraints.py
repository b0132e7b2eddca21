"""What over-determines a contact, and how each cause of error would show in it.

A straight uniform rod with one contact force bends in a plane, so m·n̂ = 0 (one force carries no
couple) and m·t = 0 (no torsion); and either s₁ = L (tip) or t·n̂ = 0 (tangential contact without
friction: k² = ½), of which the rod obeys one. All are taken where the ideal rod's curvature
vanishes; the tip's as g (L − s₁), with g = ‖t × n‖ the slope of the moment there, which is linear
in the noise through first contact.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.inverse.checks.line import (
    CURVATURE,
    LOAD,
    PARAMETERS,
    TAPER,
    ends,
    first_zeros,
    zeros_from,
)

COUPLE, TORSION, TIP, TANGENT = range(4)
"""Rows of the constraints."""
_WIDTH = 96
"""Rods that one compiled loop takes at a time: about as many as there are stretches."""


class Slopes(NamedTuple):
    """Of the constraints (k, 4) and the contact point (k, 3), clamp axes and model units, by what
    could be wrong.
    """

    constraints: Float[np.ndarray, "k 4 p"]
    point: Float[np.ndarray, "k 3 p"]

    def __matmul__(self, step: Float[np.ndarray, "k p q"]) -> "Slopes":
        return Slopes(self.constraints @ step, self.point @ step)


@dataclass(frozen=True, eq=False)
class Constraints:
    """Values at the stretches in contact, and their derivatives.

    Attributes
    ----------
    value
        (k, 4) of m·n̂, m·t, g (1 − s₁) and t·n̂.
    reach, tangent, force
        (k, 3) of the contact, clamp axes; `force` on the rod.
    arc_length
        (k,).
    steepness
        (k,) g.
    by_wrench, by_taper, by_curvature, by_load
        Derivatives by base wrench (6), share of the radius lost at the tip (1), rest curvature (2),
        load per length (3), clamp axes.
    """

    value: Float[np.ndarray, "k 4"]
    reach: Float[np.ndarray, "k 3"]
    tangent: Float[np.ndarray, "k 3"]
    force: Float[np.ndarray, "k 3"]
    arc_length: Float[np.ndarray, "k"]
    steepness: Float[np.ndarray, "k"]
    by_wrench: Slopes
    by_taper: Slopes
    by_curvature: Slopes
    by_load: Slopes


def constraints_of(
    wrench: Float[np.ndarray, "k 6"],
    rod: Float[np.ndarray, "k 6"] | None = None,
    length: float = 1.0,
) -> Constraints:
    """Constraints for base wrenches (f0, m0), clamp axes, of ideal rods, or of such with taper,
    rest curvature (2) and load (3), and of a length other than 1.
    """
    arc_length = np.concatenate([np.asarray(first_zeros(*block)) for block in _blocks(wrench)])[
        : len(wrench)
    ]
    parameters = np.concatenate(
        [wrench, np.zeros((len(wrench), PARAMETERS - 6)) if rod is None else rod], axis=1
    )
    if rod is not None and np.any(rod):
        arc_length = np.concatenate(
            [np.asarray(zeros_from(*block)) for block in _blocks(parameters, arc_length)]
        )[: len(wrench)]
    value, slope = _ends(parameters, arc_length)
    n, t, m = value.force, value.tangent, value.moment
    f = np.linalg.norm(n, axis=1, keepdims=True)
    direction = n / f
    rate = -np.cross(t, n)
    g = np.linalg.norm(rate, axis=1)
    across = rate / g[:, None]

    def along(
        matrix: Float[np.ndarray, "k 3 p"], vector: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "k p"]:
        return np.einsum("kip,ki->kp", matrix, vector)

    def dot(a: Float[np.ndarray, "k 3"], b: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k"]:
        return np.einsum("ki,ki->k", a, b)

    turning = (slope.force - direction[:, :, None] * along(slope.force, direction)[:, None]) / f[
        :, :, None
    ]
    beyond = along(slope.moment, across)
    # Where the constraints hold, the moment is zero: what turns its axes says nothing, and noise
    # times it would look like a cause.
    constraints = np.stack(
        [
            along(slope.moment, direction),
            along(slope.moment, t),
            beyond,
            along(slope.tangent, direction) + along(turning, t),
        ],
        axis=1,
    )
    point = slope.reach - t[:, :, None] * (beyond / g[:, None])[:, None]
    off = dot(m, across)
    parts = {
        name: Slopes(constraints[:, :, where], point[:, :, where])
        for name, where in (
            ("by_wrench", slice(0, 6)),
            ("by_taper", slice(TAPER, TAPER + 1)),
            ("by_curvature", CURVATURE),
            ("by_load", LOAD),
        )
    }
    return Constraints(
        value=np.stack(
            [dot(m, direction), dot(m, t), g * (length - arc_length) + off, dot(t, direction)],
            axis=1,
        ),
        reach=value.reach - t * (off / g)[:, None],
        tangent=t,
        force=n,
        arc_length=arc_length - off / g,
        steepness=g,
        **parts,
    )


class Ends(NamedTuple):
    """`vibrissa.inverse.checks.line.End`, fetched: of all rods, or its derivatives by their
    parameters.
    """

    moment: Float[np.ndarray, "k 3 *p"]
    force: Float[np.ndarray, "k 3 *p"]
    tangent: Float[np.ndarray, "k 3 *p"]
    reach: Float[np.ndarray, "k 3 *p"]


def _ends(
    parameters: Float[np.ndarray, "k 12"], arc_length: Float[np.ndarray, "k"]
) -> tuple[Ends, Ends]:
    """In blocks of one size."""
    pairs = [ends(*block) for block in _blocks(parameters, arc_length)]
    value, slope = (
        Ends(
            *(
                np.concatenate(list(map(np.asarray, field)))[: len(arc_length)]
                for field in zip(*parts, strict=True)
            )
        )
        for parts in zip(*pairs, strict=True)
    )
    return value, slope


def _blocks(*rows: np.ndarray) -> list[tuple[np.ndarray, ...]]:
    filled = [
        np.concatenate([part, np.repeat(part[:1], -len(part) % _WIDTH, axis=0)]) for part in rows
    ]
    return [
        tuple(part[first : first + _WIDTH] for part in filled)
        for first in range(0, len(filled[0]), _WIDTH)
    ]
