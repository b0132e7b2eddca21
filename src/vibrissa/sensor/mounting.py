"""Sign, clamp and reference point of the setup, held against the readings."""

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.geometry.rotation import rotation_vectors, third_axis
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.raw import CHANNELS

_LOADED = 20.0
_FEWEST_LOADED = 10
_NEGATIVE, _NOTICEABLE, _LOST = 0.5, 0.02, 0.02
_FURTHEST = 1.1
_BEHIND, _FAR = -0.1, 0.3


def loaded_rows(reactions: Reactions) -> Bool[np.ndarray, "n"]:
    """Rows of more than twenty times the force at the start."""
    force = np.linalg.norm(reactions.force, axis=-1)
    finite = force[np.isfinite(force)]
    if not len(finite):
        return np.zeros(len(force), dtype=bool)
    rest = float(np.median(finite[: max(2, len(finite) // 50)]))
    return np.asarray(force > max(_LOADED * rest, 1e-12))


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
    count = int(np.count_nonzero(loaded))
    if count < _FEWEST_LOADED or reactions.time is None:
        return []
    texts = []
    work, scale = _work(reactions, loaded)
    pulled = (
        float(
            np.median(
                np.sum(reactions.force * third_axis(reactions.trail.orientation), axis=1)[loaded]
            )
        )
        < 0
    )
    if pulled and work < 0 and -work > _NOTICEABLE * scale:
        texts.append(
            f"the rod is pulled from its clamp and does work on it, {1e3 * work:.3g} mJ, where one that is pushed takes up work: as of a wrench of the other sign; "
            "check wrench in [sensor]"
        )
    points = lines_of_action(reactions)[loaded] / rod.length
    away = float(np.median(np.linalg.norm(points, axis=1)))
    ahead = float(
        np.median(np.sum(points * third_axis(reactions.trail.orientation)[loaded], axis=1))
    )
    if away > _FURTHEST:
        texts.append(
            f"the contact forces act along lines {away:.3g} rod lengths from the clamp in the median, where no rod is: check clamp_position, wrench_point and length"
        )
    elif ahead < _BEHIND and away > _FAR:
        texts.append(
            f"the contact forces act {-ahead:.3g} rod lengths behind the clamp in the median, to where no rod leaves: check clamp_orientation, along whose +z it does"
        )
    time = reactions.time[loaded]
    return [
        Fault(FaultKind.MOUNT, CHANNELS, float(time[0]), float(time[-1]), count, text)
        for text in texts
    ]


def _work(reactions: Reactions, loaded: Bool[np.ndarray, "n"]) -> tuple[float, float]:
    """Lowest of the clamp's work since the first load [J], 0 unless it is most of all that comes
    up, and the work that the forces could do along the whole way.

    Nothing is told of a recording that begins under load, or of whose load a part is missing.
    """
    known = np.flatnonzero(np.isfinite(reactions.force).all(axis=1))
    rows = np.flatnonzero(loaded)
    lost = rows[-1] + 1 - rows[0] - np.count_nonzero((known >= rows[0]) & (known <= rows[-1]))
    if known[0] == rows[0] or lost > _LOST * len(rows):
        return 0.0, 0.0
    force, moment = reactions.force[known], reactions.moment[known]
    position, orientation = reactions.trail.position[known], reactions.trail.orientation[known]
    way, turn = np.diff(position, axis=0), rotation_vectors(orientation[:-1], orientation[1:])
    steps = 0.5 * np.sum((force[1:] + force[:-1]) * way + (moment[1:] + moment[:-1]) * turn, axis=1)
    either = loaded[known][1:] | loaded[known][:-1]
    most = np.linalg.norm(force[1:], axis=1) * np.linalg.norm(way, axis=1) + np.linalg.norm(
        moment[1:], axis=1
    ) * np.linalg.norm(turn, axis=1)
    work = np.cumsum(np.where(either, steps, 0.0))
    lowest = float(work.min())
    return (lowest if -lowest > _NEGATIVE * float(np.abs(work).max()) else 0.0), float(
        most[either].sum()
    )
