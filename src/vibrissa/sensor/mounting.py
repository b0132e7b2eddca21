"""Sign, clamp and reference point of the setup, held against the readings."""

import numpy as np
from jaxtyping import Float

from vibrissa.geometry.rotation import rotation_vectors, third_axis
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.raw import CHANNELS, Rows

# Forces of so many times the one at the start, at rest, are loads; a median needs some of them.
_LOADED, _LEAST_LOAD = 20.0, 1e-12
_FEWEST_LOADED = 10
# Of the largest work, and of what the forces could do at most: less may be friction or noise. Of
# the loaded rows: with more of them lost, so is a part of the work.
_NEGATIVE, _NOTICEABLE, _LOST = 0.5, 0.02, 0.02
# Rod lengths from the clamp, at all and along its axis: a contact lies nearer.
_FURTHEST = 1.1
_BEHIND, _FAR = -0.1, 0.3


def loaded_rows(reactions: Reactions) -> Rows:
    """Rows of more than twenty times the force at the start."""
    force = np.linalg.norm(reactions.force, axis=-1)
    finite = force[np.isfinite(force)]
    if not len(finite):
        return np.zeros(len(force), dtype=bool)
    rest = float(np.median(finite[: max(2, len(finite) // 50)]))
    return np.asarray(force > max(_LOADED * rest, _LEAST_LOAD))


def lines_of_action(reactions: Reactions) -> Float[np.ndarray, "n 3"]:
    """Points (n, 3) on the lines along which the contact forces act, those next to the clamp, seen
    from it in world axes: a contact lies on its line, no nearer.
    """
    square = np.sum(reactions.force**2, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.cross(reactions.force, reactions.moment) / square


def mount_faults(reactions: Reactions, rod: Rod) -> list[Fault]:
    """What only a wrong sign, clamp or reference point explains.

    The clamp's work on a rod that is free at first is its bending energy and what friction took,
    never negative, and contacts push the rod into its clamp: both are the other way round where the
    wrench has the other sign. The line of the contact force passes the clamp within the rod's
    length, on the side to which the rod leaves.
    """
    loaded = loaded_rows(reactions)
    if np.count_nonzero(loaded) < _FEWEST_LOADED or reactions.time is None:
        return []
    axis, points = (
        part[loaded]
        for part in (third_axis(reactions.trail.orientation), lines_of_action(reactions))
    )
    push = float(np.median(np.sum(reactions.force[loaded] * axis, axis=1)))
    away = float(np.median(np.linalg.norm(points, axis=1))) / rod.length
    ahead = float(np.median(np.sum(points * axis, axis=1))) / rod.length
    work, most = _work(reactions, loaded)
    texts = []
    if push < 0 and -work > _NOTICEABLE * most:
        texts.append(
            f"the rod is pulled from its clamp and does work on it, {1e3 * work:.3g} mJ, where one "
            "that is pushed takes up work: this fits a wrench of the other sign; check wrench in "
            "[sensor]"
        )
    if away > _FURTHEST:
        texts.append(
            f"the contact forces act along lines {away:.3g} rod lengths from the clamp in the "
            "median, where no rod is: check clamp_position, wrench_point and length"
        )
    elif ahead < _BEHIND and away > _FAR:
        texts.append(
            f"the contact forces act {-ahead:.3g} rod lengths behind the clamp in the median, "
            "but the rod leaves to the other side: check clamp_orientation, whose +z it follows"
        )
    stamps = reactions.time[loaded]
    return [Fault.over(FaultKind.MOUNT, CHANNELS, stamps, text) for text in texts]


def _work(reactions: Reactions, loaded: Rows) -> tuple[float, float]:
    """Lowest of the clamp's work since the first load [J], 0 unless it is most of all that comes
    up, and the work that the forces could do along the whole way.

    Nothing is told of a recording that begins under load, or of whose load a part is missing.
    """
    finite = np.isfinite(reactions.force).all(axis=1)
    known, rows = np.flatnonzero(finite), np.flatnonzero(loaded)
    lost = np.count_nonzero(~finite[rows[0] : rows[-1] + 1])
    if known[0] == rows[0] or lost > _LOST * len(rows):
        return 0.0, 0.0
    trail = reactions.trail
    way = np.diff(trail.position[known], axis=0)
    turn = rotation_vectors(trail.orientation[known[:-1]], trail.orientation[known[1:]])
    either = loaded[known][1:] | loaded[known][:-1]
    steps, most = np.zeros(len(way)), 0.0
    for load, path in ((reactions.force[known], way), (reactions.moment[known], turn)):
        steps += np.sum((load[1:] + load[:-1]) / 2 * path, axis=1)
        sizes = np.linalg.norm(load[1:], axis=1) * np.linalg.norm(path, axis=1)
        most += float(sizes[either].sum())
    work = np.cumsum(np.where(either, steps, 0.0))
    lowest = float(work.min())
    return (lowest if -lowest > _NEGATIVE * float(np.abs(work).max()) else 0.0), most
