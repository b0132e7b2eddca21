"""What happens on a trail, and where."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float


class EventKind(IntEnum):
    """Kinds of events on a trail."""

    FIRST_CONTACT = 1
    """The free rod meets the object, with its tip or its flank; again after every loss of
    contact.
    """
    TIP_TO_TANGENTIAL = 2
    TANGENTIAL_TO_TIP = 3
    DETACH = 4
    """The contact force falls to zero."""
    SNAP = 5
    """The equilibrium ceases to exist at a fold; the rod jumps free, or to another equilibrium."""
    LATERAL_INSTABILITY = 6
    """A direction across the branch becomes singular: a real rod leaves its bending plane."""
    LATERAL_RECOVERY = 7
    """The branch becomes stable again."""
    STARTED_IN_CONTACT = 8
    """The trail begins with the free rod inside the object, or resumes that way after unsolved
    positions. At the beginning of a trail the rod is brought in as if its first step had come from
    outside; where that does not go smoothly, the admissible equilibrium of least energy is taken.
    """
    STICK_TO_SLIP = 10
    """With friction: the contact force reaches the cone."""
    SLIP_TO_STICK = 11
    """With friction: sliding ends; the contact sticks, or rolls."""
    HEAD_ON = 9
    """The rod meets the object along its own axis: it does not bend until it buckles, in a
    direction that is not determined.
    """


@dataclass(frozen=True, eq=False)
class Event:
    """One event.

    Attributes
    ----------
    kind
        What happened.
    trail
        Which trail, 0 if there is one.
    parameter
        0 to 1 along the trail (`Trail.parameter`).
    clamp, point
        Clamp point and contact point there (3,), in units of the rod.
    """

    kind: EventKind
    trail: int
    parameter: float
    clamp: Float[np.ndarray, "3"]
    point: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Happening:
    """An event as the solver records it: on the stretch that ends at `index`, at a fraction of it,
    with the contact point [L].
    """

    kind: EventKind
    lane: int
    index: int
    fraction: float
    point: Float[np.ndarray, "3"]
