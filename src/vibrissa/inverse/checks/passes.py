"""Pose delay, detected from back-and-forth passes over the same object.

The wrench in clamp axes does not depend on the clock of the poses, so one pass at constant speed
shows no delay: all contacts shift alike. Two passes in opposite directions shift against each
other. If poses come late by τ, a contact lies at p + v τ, where v is the velocity of the clamp's
frame at p, and neighbouring points a, b of two passes lie on one surface:

    n̂·(p_a − p_b) = −τ n̂·(v_a − v_b),    n̂ the mean of both normals.

On a sphere the chord of two points is perpendicular to the mean of their normals, so the distance
between a and b enters only at third order; friction tilts the forces of opposite passes by opposite
angles, and the mean not at all.
"""

import numpy as np
from jaxtyping import Int
from scipy.spatial import cKDTree

from vibrissa.contacts import Status
from vibrissa.inverse.arrays import Scalars, Vectors
from vibrissa.inverse.checks.findings import Cause
from vibrissa.inverse.result import Reconstruction

_POINTS = 400
"""Means along a sweep: the error that curvature makes in a mean is below that of noise, and pairs
are dense.
"""
_NEAR = 0.02
"""Largest distance between compared points [L]: beyond it third-order terms for a radius of a third
of L exceed 1e-5 L.
"""
_OPPOSED = -0.5
_ALIKE = 0.9
"""Cosines between velocities and between normals."""
_MOVING = 0.1
"""Fraction of the usual speed below which the clamp is about to turn back, and a delay shifts
nothing.
"""
_BLOCKS = 12
"""Parts of the sweep: lasting errors, of tare and model, are about the same within a twelfth, and
differ from one to another.
"""
_FEWEST = 6
"""Pairs in a block, and blocks, below which nothing is reported."""
_ALL_ALIKE = 4e-6
"""Share of the slopes' square about their mean below which an offset explains as much as a delay: a
condition number of 1e6.
"""
_CERTAIN = 5.0
"""Standard deviations: as for the other causes."""
_MATTERS = 5e-4
"""Shift of the contacts [L] from which a delay is worth a warning: 25 µm on 50 mm, half the error
of smoothed contacts.
"""
_TOLERATED = 3.0
"""Stated standard deviations up to which a delay agrees with the setup."""


def contradicting_delay(found: Reconstruction) -> Cause | None:
    """Pose delay [s] shown by the contacts of one trail (n, …), positive if poses are late,
    provided it is certain, matters, and exceeds the setup's tolerance; else None, as without time,
    or without two passes in opposite directions over the same places.
    """
    if found.reactions.time is None or found.kind.ndim != 1:
        return None
    rows = np.flatnonzero(
        found.in_contact
        & np.isin(found.status, (Status.OK, Status.SETUP_CONTRADICTED))
        & np.isfinite(found.point + found.force_direction).all(axis=1)
    )
    if len(rows) < _FEWEST * _BLOCKS:
        return None
    # Means over short stretches of contact, none of which contains a gap.
    size = max(1, len(rows) // _POINTS)
    starts = np.flatnonzero((np.diff(rows, prepend=-2) > 1) | (np.arange(len(rows)) % size == 0))
    count = np.diff(starts, append=len(rows))[:, None]
    place, normal, velocity = (
        np.add.reduceat(part[rows], starts) / count
        for part in (found.point, found.force_direction, carried(found))
    )
    normal = _unit(normal)
    first, second = _pairs(place, normal, velocity, found.rod.length)
    if len(first) < _FEWEST * _FEWEST:
        return None
    across = _unit(normal[first] + normal[second])
    apart, slope = (
        np.sum(across * (part[first] - part[second]), axis=1) for part in (place, -velocity)
    )
    seconds, deviation = _by_blocks(slope, apart)
    shift = abs(seconds) * float(np.median(np.linalg.norm(velocity, axis=1)))
    certainty = abs(seconds) / deviation
    errors = found.reactions.setup_errors
    tolerated = 0.0 if errors is None else _TOLERATED * np.sqrt(errors.covariance[-1, -1])
    if certainty < _CERTAIN or shift < _MATTERS * found.rod.length or abs(seconds) <= tolerated:
        return None
    return Cause("pose_delay", "s", (seconds,), (deviation,), certainty, np.nan, shift)


def carried(found: Reconstruction) -> Vectors:
    """Velocity of the clamp's frame at the contacts (n, 3): how far a delay of one second shifts
    them, units of the rod.
    """
    velocity = found.reactions.clamp_velocity()
    arm = found.point - found.reactions.trail.position
    return np.asarray(velocity[:, :3] + np.cross(velocity[:, 3:], arm))


def _unit(vectors: Vectors) -> Vectors:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _pairs(
    place: Vectors,
    normal: Vectors,
    velocity: Vectors,
    length: float,
) -> Int[np.ndarray, "2 p"]:
    """Each point with the nearest one of an opposite pass; each pair once."""
    speed = np.linalg.norm(velocity, axis=1)
    moving = speed > _MOVING * float(np.median(speed))
    a, b = pairs = cKDTree(place).query_pairs(_NEAR * length, output_type="ndarray").T
    opposed = np.sum(velocity[a] * velocity[b], axis=1) < _OPPOSED * speed[a] * speed[b]
    good = opposed & (np.sum(normal[a] * normal[b], axis=1) > _ALIKE) & moving[a] & moving[b]
    a, b = pairs = pairs[:, good]
    nearest = np.argsort(np.linalg.norm(place[a] - place[b], axis=1), kind="stable")
    return pairs[:, np.sort(nearest[np.unique(a[nearest], return_index=True)[1]])]


def _by_blocks(slope: Scalars, apart: Scalars) -> tuple[float, float]:
    """Delay and its standard deviation: least squares with an offset, as from a drifting zero, and
    the scatter between parts of the sweep; infinite if an offset explains as much.
    """
    own = slope - slope.mean()
    square = own @ own
    if square <= _ALL_ALIKE * (slope @ slope):
        return 0.0, np.inf
    seconds = own @ apart / square
    left = apart - apart.mean() - seconds * own
    starts = -(-np.arange(_BLOCKS) * len(slope) // _BLOCKS)
    scores = np.add.reduceat(own * left, starts)
    # Blocks scatter about a fit to themselves: it uses up two of twelve degrees of freedom.
    variance = scores @ scores * _BLOCKS / (_BLOCKS - 2)
    return float(seconds), float(np.sqrt(variance) / square)
