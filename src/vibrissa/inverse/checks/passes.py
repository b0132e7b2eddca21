"""Poses that come late, told by passes to and fro over the same object.

The wrench seen from the clamp does not change with the clock of the poses, so one pass at constant
speed shows no delay: all contacts are shifted alike. Two passes in opposite directions are shifted
against each other. With poses late by τ a contact lies at p + v τ, where v is the velocity of the
clamp's frame at p, and near points a, b of two passes lie on one surface:

    n̂·(p_a − p_b) = −τ n̂·(v_a − v_b),    n̂ the mean of both normals.

On a sphere the chord of two points is square to the mean of their normals, so the distance of a and
b enters in third order only; friction turns the forces of opposite passes by opposite angles, and
the mean not at all.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from vibrissa.contacts import Status
from vibrissa.inverse.result import Reconstruction

_POINTS = 400
"""Means along a sweep: an error of the mean by curvature is below that of noise, and pairs are
dense.
"""
_NEAR = 0.02
"""Distance of two points that are compared [L]: beyond it third orders of a radius of a third of L
exceed 1e-5 L.
"""
_OPPOSED = -0.5
_ALIKE = 0.9
"""Cosines between velocities and between normals."""
_MOVING = 0.1
"""Share of the usual speed below which the clamp is about to turn back, and a delay shifts nothing.
"""
_BLOCKS = 12
"""Parts of the sweep: errors that last, of the tare and of the model, are about the same within a
twelfth, and differ from one to another.
"""
_FEWEST = 6
"""Pairs in a block, and blocks, below which nothing is told."""
_CERTAIN = 5.0
"""Standard deviations: as for the other causes."""
_MATTERS = 5e-4
"""Shift of the contacts [L] from which a delay is a warning: 25 µm on 50 mm, half of what smoothed
contacts are known to.
"""
_TOLERATED = 3.0
"""Stated standard deviations up to which a delay is as stated."""


@dataclass(frozen=True)
class Delay:
    """By how much poses come late, by the contacts of passes to and fro.

    Attributes
    ----------
    seconds, deviation
        [s]; positive where late.
    shift
        Median size of what it shifts contacts by, units of the rod.
    """

    seconds: float
    deviation: float
    shift: float


def delay_of(found: Reconstruction) -> Delay | None:
    """Delay that the contacts of one trail (n, …) tell; None where there is no time, or no two
    passes in opposite directions over the same places.
    """
    if found.reactions.time is None or found.kind.ndim != 1:
        return None
    rows = (
        found.in_contact
        & np.isin(found.status, (Status.OK, Status.SETUP_CONTRADICTED))
        & np.isfinite(found.point + found.force_direction).all(axis=1)
    )
    if np.count_nonzero(rows) < _FEWEST * _BLOCKS:
        return None
    place, normal, velocity = _means(found, np.flatnonzero(rows))
    first, second = _pairs(place, normal, velocity, found.rod.length)
    if len(first) < _FEWEST * _FEWEST:
        return None
    across = normal[first] + normal[second]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    apart = np.sum(across * (place[first] - place[second]), axis=1)
    slope = -np.sum(across * (velocity[first] - velocity[second]), axis=1)
    fitted = _by_blocks(slope, apart)
    if fitted is None:
        return None
    shift = abs(fitted[0]) * float(np.median(np.linalg.norm(velocity, axis=1)))
    return Delay(*fitted, shift)


def contradicts(delay: Delay | None, found: Reconstruction) -> bool:
    """Whether a delay is certain, matters, and is more than the setup tolerates."""
    if (
        delay is None
        or abs(delay.seconds) < _CERTAIN * delay.deviation
        or delay.shift < _MATTERS * found.rod.length
    ):
        return False
    errors = found.reactions.setup_errors
    return errors is None or abs(delay.seconds) > _TOLERATED * float(
        np.sqrt(errors.covariance[-1, -1])
    )


def shift_by(delay: Delay, found: Reconstruction) -> Float[np.ndarray, "n 3"]:
    """Of the contacts (n, 3), units of the rod."""
    return np.asarray(delay.seconds * _carried(found))


def _carried(found: Reconstruction) -> Float[np.ndarray, "n 3"]:
    """Velocity of the clamp's frame at the contacts (n, 3)."""
    velocity = found.reactions.clamp_velocity()
    return np.asarray(
        velocity[:, :3] + np.cross(velocity[:, 3:], found.point - found.reactions.trail.position)
    )


def _means(
    found: Reconstruction, rows: Int[np.ndarray, "m"]
) -> tuple[Float[np.ndarray, "k 3"], ...]:
    """Place, normal and velocity over short stretches of contact, none of which holds a gap."""
    size = max(1, len(rows) // _POINTS)
    starts = np.flatnonzero((np.diff(rows, prepend=-2) > 1) | (np.arange(len(rows)) % size == 0))
    count = np.diff(starts, append=len(rows))[:, None]
    means = (
        np.add.reduceat(part[rows], starts) / count
        for part in (found.point, found.force_direction, _carried(found))
    )
    place, normal, velocity = means
    return place, normal / np.linalg.norm(normal, axis=1, keepdims=True), velocity


def _pairs(
    place: Float[np.ndarray, "k 3"],
    normal: Float[np.ndarray, "k 3"],
    velocity: Float[np.ndarray, "k 3"],
    length: float,
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """Each point with the nearest of an opposite pass; each pair once."""
    speed = np.linalg.norm(velocity, axis=1)
    moving = speed > _MOVING * float(np.median(speed))
    a, b = cKDTree(place).query_pairs(_NEAR * length, output_type="ndarray").T
    opposed = np.sum(velocity[a] * velocity[b], axis=1) < _OPPOSED * speed[a] * speed[b]
    good = opposed & (np.sum(normal[a] * normal[b], axis=1) > _ALIKE) & moving[a] & moving[b]
    a, b = a[good], b[good]
    nearest = np.argsort(np.linalg.norm(place[a] - place[b], axis=1), kind="stable")
    chosen = np.sort(nearest[np.unique(a[nearest], return_index=True)[1]])
    return a[chosen], b[chosen]


def _by_blocks(
    slope: Float[np.ndarray, "p"], apart: Float[np.ndarray, "p"]
) -> tuple[float, float] | None:
    """Delay and its standard deviation: least squares with an offset, as of a zero that drifts, and
    the scatter between parts of the sweep.
    """
    design = np.column_stack([slope, np.ones(len(slope))])
    blocks = np.arange(len(slope)) * _BLOCKS // len(slope)
    normal = design.T @ design
    if np.linalg.cond(normal / np.sqrt(np.outer(np.diag(normal), np.diag(normal)))) > 1e6:
        return None
    inverse = np.linalg.inv(normal)
    solution = inverse @ design.T @ apart
    left = apart - design @ solution
    scores = np.stack(
        [design[blocks == block].T @ left[blocks == block] for block in range(_BLOCKS)]
    )
    # Blocks scatter about a fit to themselves: two numbers of twelve are spent.
    covariance = inverse @ (scores.T @ scores) @ inverse * _BLOCKS / (_BLOCKS - 2)
    return float(solution[0]), float(np.sqrt(covariance[0, 0]))
