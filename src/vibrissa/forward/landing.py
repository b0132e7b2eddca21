"""How a lane begins anew within a stretch: free, at the next first contact of the straight rod, or
at an equilibrium after a snap.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.contacts import Status
from vibrissa.forward.approach import clearances, first_contacts
from vibrissa.forward.equations import Scene
from vibrissa.forward.events import EventKind
from vibrissa.forward.locate import WIDTH as EVENT_LANES
from vibrissa.forward.march import Mode
from vibrissa.forward.path import pose_between, shortened
from vibrissa.forward.search import Equilibrium, stable_equilibria

HEAD_ON_COSINE = -1 + 1e-9
CLEAR = -1e-10
"""Clearance [L] from which the straight rod counts as outside the object."""
NO_FORCE = 1e-7
"""[EI/L²] up to which a contact counts as one that has just begun, or is about to end."""
AFTER_CONTACT = (1e-3, 1e-2, 0.1, 1.0)
"""Fractions of a stretch behind a first contact at which its equilibrium is looked for."""
MOST_CHANGES = 12
"""Losses and renewals of contact on one stretch."""


@dataclass
class Outcome:
    """How a stretch ended: mode, state, figure (as in `Steps`) and phase at its end, what happened
    on it, and a status where it failed.
    """

    mode: Mode
    x: Float[np.ndarray, "size"]
    figure: float = np.nan
    phase: float = np.nan
    happened: list[tuple[EventKind, float, Float[np.ndarray, "3"]]] = field(default_factory=list)
    status: Status = Status.OK


def clearance_at(scene: Scene, stretch: Float[np.ndarray, "14"], fraction: float) -> float:
    """Clearance of the straight rod [L]."""
    point, tangent = pose_between(stretch, np.array([fraction]))
    return float(scene.in_blocks(clearances, point[None], tangent[None])[0, 0])


class FirstContact(NamedTuple):
    """Where the straight rod meets the object: fraction of the stretch, point, arc length [L] and
    the rod's tangent.
    """

    fraction: float
    point: Float[np.ndarray, "3"]
    arc_length: float
    tangent: Float[np.ndarray, "3"]


def first_contact_on(
    scene: Scene, stretch: Float[np.ndarray, "14"], fraction: float, outcome: Outcome
) -> FirstContact | None:
    """Next first contact of the free rod between `fraction` and the end, if there is one and it
    bends the rod; noted in the outcome.
    """
    distances = np.array([clearance_at(scene, stretch, at) for at in (fraction, 1.0)])
    if distances[1] >= CLEAR:
        return None
    rest = shortened(stretch, np.asarray(fraction), np.asarray(1.0))
    share, *point, s, cosine = scene.in_blocks(
        first_contacts, rest[None, :], distances[None, :], width=EVENT_LANES
    )[0]
    at = float(fraction + (1 - fraction) * share)
    if cosine < HEAD_ON_COSINE:
        outcome.happened.append((EventKind.HEAD_ON, at, np.array(point)))
        failed(outcome, Status.HEAD_ON)
        return None
    outcome.happened.append((EventKind.FIRST_CONTACT, at, np.array(point)))
    _, tangent = pose_between(stretch, np.array([at]))
    return FirstContact(at, np.array(point), float(s), tangent)


def settled_on(
    scene: Scene,
    stretch: Float[np.ndarray, "14"],
    fraction: float,
    energy: float,
    near: list[Float[np.ndarray, "3"]],
) -> Equilibrium | None:
    """The stable equilibrium without friction of least energy, if that is below `energy`."""
    point, tangent = pose_between(stretch, np.array([fraction]))
    found = stable_equilibria(scene, point, tangent, near)
    return found[0] if found and found[0].energy < energy else None


def settled_at_the_end(
    scene: Scene, stretch: Float[np.ndarray, "14"], outcome: Outcome
) -> Equilibrium | None:
    """The same at the end of a stretch, of whose past nothing is known; where there is none, or to
    what side the rod bends depends on that past, the lane is lost.
    """
    found = settled_on(scene, stretch, 1.0, np.inf, [])
    if found is None or found.neutral:
        failed(outcome, Status.NO_EQUILIBRIUM if found is None else Status.HEAD_ON)
        return None
    return found


def failed(outcome: Outcome, status: Status) -> Outcome:
    """Note that the lane is lost, and why."""
    outcome.mode, outcome.status, outcome.x = Mode.LOST, status, np.full_like(outcome.x, np.nan)
    return outcome
