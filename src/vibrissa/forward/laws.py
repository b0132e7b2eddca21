"""The seam of contact laws: what the sweep needs to know of each."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from vibrissa.forward.equations import Scene
from vibrissa.forward.follow import follow
from vibrissa.forward.friction import SIZE, UNKNOWNS
from vibrissa.forward.landing import Outcome
from vibrissa.forward.locate import roots
from vibrissa.forward.march import March, Mode, march
from vibrissa.forward.meetings import Meetings
from vibrissa.forward.rubbing import follow_rubbing, march_rubbing, roots_rubbing

_FRICTIONLESS_SIZE = 4


@dataclass(frozen=True)
class ContactLaw:
    """How a contact goes on from one position to the next.

    Attributes
    ----------
    size
        Numbers of a state; the first four are p and f.
    branch
        Whether the equilibria form a branch, without memory.
    march, follow
        The kernel that walks many lanes, and what resolves one stretch with care.
    roots
        Fraction and state where an indicator is zero, on stretches, between two ends (fraction,
        state, indicator) twice.
    """

    size: int
    branch: bool
    march: March
    follow: Callable[[Scene, Float[np.ndarray, "14"], Mode, Float[np.ndarray, "size"]], Outcome]
    roots: Callable[
        [Scene, Float[np.ndarray, "k 14"], Float[np.ndarray, "k ends"], Int[np.ndarray, "k"]],
        Float[np.ndarray, "k fraction_and_state"],
    ]

    def states_at(self, meetings: Meetings) -> Float[np.ndarray, "k size"]:
        """States of first contacts: no force yet."""
        k = len(meetings.lane)
        nothing = np.zeros((k, min(self.size, UNKNOWNS) - 3))
        history = [meetings.arc_length[:, None], meetings.tangent] if self.size == SIZE else []
        return np.concatenate([meetings.point, nothing, *history], axis=1)


FRICTIONLESS = ContactLaw(_FRICTIONLESS_SIZE, branch=True, march=march, follow=follow, roots=roots)
RUBBING = ContactLaw(
    SIZE, branch=False, march=march_rubbing, follow=follow_rubbing, roots=roots_rubbing
)
