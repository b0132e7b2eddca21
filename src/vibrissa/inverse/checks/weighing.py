"""Causes of error, each as large as explains most of what the constraints of a sweep leave; the
best first.
"""

from operator import attrgetter
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.inverse.arrays import Vectors
from vibrissa.inverse.checks.case import Case, Misfit, Numbers, Phases, Square
from vibrissa.inverse.checks.rig import ERRORS, FRICTION, RUBBING, SUSPECTS

MATTERS = 1e-3
"""Shift of the contacts [L], in a fifth of the sweep, below which a cause does not matter: 50 µm on
50 mm, like smoothed error bars.
"""
_LEAST = 20.0
"""χ² that a cause must explain: four and a half standard deviations, for some thirty causes tried;
sound recordings show 3.6 at most.
"""
_PRICE = 6.0
"""χ² charged for each further number that a cause may choose (BIC for some four hundred rows)."""
_ALIKE, _ALIKE_BY = 0.05, 10.0
"""Causes are named along with the best if they explain less by at most this fraction of it, plus
this much χ².
"""
_WITH_FRICTION = 100.0
"""χ² that a cause must explain where friction leaves s₁ and k² open: the remaining constraints tell
less reliably.
"""


class Tried(NamedTuple):
    """One cause of `SUSPECTS`, as large as explains most."""

    name: str
    size: Numbers
    covariance: Square
    explained: float
    """Drop in χ²."""
    shifts: Float[np.ndarray, "n 3 errors"]
    """Derivatives of the contacts by the errors."""

    @property
    def score(self) -> float:
        """What it explains, less a penalty for its numbers."""
        return self.explained - _PRICE * (len(self.size) - 1)

    @property
    def moved(self) -> Vectors:
        """Shift of the contacts that it implies, clamp axes [L]."""
        return self.shifts @ (SUSPECTS[self.name] @ self.size)

    def shift(self, share: float) -> float:
        """Size of the shift that this fraction of the sweep does not exceed."""
        return float(np.quantile(np.linalg.norm(self.moved, axis=1), share))


class Weighed(NamedTuple):
    """A case in its phases, and all causes on top of friction, the best first."""

    case: Case
    tip: Phases
    misfit: Misfit
    """With noise scaled up to what the case shows, and friction as uneven as it shows."""
    friction: float
    """Apparent coefficient."""
    tried: list[Tried]

    @property
    def alike(self) -> list[Tried]:
        """The best, and those that explain about as much."""
        least = self.tried[0].score * (1 - _ALIKE) - _ALIKE_BY
        return [one for one in self.tried if one.score >= least]

    def explains(self, least: float) -> bool:
        """Whether causes that explain about the same explain enough, and would move contacts by
        more than error bars hold: a length shows, and matters, in tip contact only.
        """
        largest = max((one.shift(0.8) for one in self.alike), default=0.0)
        return largest >= MATTERS and self.tried[0].score >= max(_LEAST, least)

    @property
    def matters(self) -> bool:
        """Whether the causes contradict the setup."""
        return self.explains(_WITH_FRICTION if self.case.silent else 0.0)


def weighed(case: Case, tip: Phases) -> Weighed:
    """All causes against the misfit of a case in these phases."""
    misfit, friction, inflation = case.misfit(tip, case.tolerated), 0.0, 1.0
    for _ in range(2):
        best = case.fitted(misfit, np.eye(ERRORS))
        # Friction is not an error.
        freedom = max(len(misfit.value) - ERRORS + 1, 1)
        inflation = max(1.0, inflation * (misfit.square - best.explained) / freedom)
        shown = abs(best.size[FRICTION]) - 2 * np.sqrt(best.covariance[FRICTION, FRICTION])
        friction = max(0.0, float(shown))
        misfit = case.misfit(tip, case.tolerated, friction, inflation)
    by_friction, shifts = case.fitted(misfit, RUBBING).explained, case.shifts(tip)
    tried = []
    for name, directions in SUSPECTS.items():
        size, covariance, explained = case.fitted(misfit, np.hstack([directions, RUBBING]))
        tried.append(Tried(name, size[:-1], covariance[:-1, :-1], explained - by_friction, shifts))
    tried.sort(key=attrgetter("score"), reverse=True)
    return Weighed(case, tip, misfit, friction, tried)
