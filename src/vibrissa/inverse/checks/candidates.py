"""Causes of error, each as large as explains most of a sweep's misfit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.inverse.checks.case import Case, Solution, solved, spread_along
from vibrissa.inverse.checks.regression import Misfit, fitted, shifts
from vibrissa.inverse.checks.suspects import SUSPECTS, TELLING, Suspect
from vibrissa.inverse.result import Reconstruction

_LEAST = 20.0
"""Of χ² that a cause has to explain: four and a half standard deviations, of some thirty causes
that are tried; sound recordings show 3.6 at most.
"""
_PRICE = 6.0
"""Of χ² for each further number that a cause may choose (BIC for some four hundred rows)."""
MATTERS = 1e-3
"""Shift of the contacts [L], in a fifth of the sweep, below which a cause does not matter: 50 µm on
50 mm, as smoothed error bars have it.
"""
_ALIKE, _ALIKE_BY = 0.05, 10.0
"""Causes are named beside the best that explain less by at most this share of it, and this of χ².
"""
_HOPELESS = 0.5
"""Share of what the best explains, below which a cause need not be solved for."""
_POOR = 3.0
"""χ² a row above which a solution is sought from the other side, too."""


class Tried(NamedTuple):
    """One cause, as large as explains most."""

    score: float
    """What it explains of χ², less a price for its numbers."""
    suspect: Suspect
    size: Float[np.ndarray, "p"]
    deviation: Float[np.ndarray, "p"]
    explained: float
    moved: Float[np.ndarray, "k 3"]
    """Shift of the contacts that it implies, clamp axes [L]."""

    @property
    def shift(self) -> float:
        """In the median."""
        return float(np.median(np.linalg.norm(self.moved, axis=1)))

    @property
    def largest(self) -> float:
        """Where it is largest, in a fifth of the sweep: a length shows, and matters, in tip contact
        alone.
        """
        return float(np.quantile(np.linalg.norm(self.moved, axis=1), 0.8))


def alike(tried: list[Tried]) -> list[Tried]:
    """The best, and those that explain about as much."""
    best = tried[0].score
    return [one for one in tried if one.score >= best * (1 - _ALIKE) - _ALIKE_BY]


def matters(together: list[Tried], least: float) -> bool:
    """Whether causes that explain about the same explain enough, and would move contacts by more
    than error bars hold.
    """
    return (
        bool(together)
        and together[0].score >= max(_LEAST, least)
        and max(one.largest for one in together) >= MATTERS
    )


def candidates(case: Case, tip: Bool[np.ndarray, "k"], misfit: Misfit) -> list[Tried]:
    """All causes beside friction, the best first."""
    rub = misfit.whitened(case.friction)
    by_friction = fitted(misfit, rub, case.friction_spread).explained if rub.shape[1] else 0.0
    moves = shifts(case.slopes, case.stretches.noise, case.here, tip)
    found = []
    for suspect in SUSPECTS:
        count = suspect.directions.shape[1]
        design = np.concatenate(
            [misfit.whitened(case.slopes.constraints @ suspect.directions), rub], axis=1
        )
        both = fitted(
            misfit,
            design,
            np.concatenate([spread_along(case, suspect.directions), case.friction_spread]),
        )
        size, explained = both.size[:count], both.explained - by_friction
        deviation = np.sqrt(np.diag(both.covariance)[:count])
        found.append(
            Tried(
                explained - _PRICE * (count - 1),
                suspect,
                size,
                deviation,
                explained,
                moves @ (suspect.directions @ size),
            )
        )
    return sorted(found, key=lambda one: -one.score)


def solved_for(
    found: Reconstruction,
    case: Case,
    tip: Bool[np.ndarray, "k"],
    misfit: Misfit,
    first: list[Tried],
) -> list[Tried]:
    """Causes that are gross: solved for, those that the linear fit finds hopeless left out."""
    none = float(misfit.value @ misfit.value)
    own = shifts(case.slopes, case.stretches.noise, case.here, tip)
    chosen = [
        one
        for one in first
        if one.suspect in SUSPECTS[:TELLING] and one.score > _HOPELESS * first[0].score
    ]
    out = []
    for one in chosen:
        directions = one.suspect.directions
        spread = spread_along(case, directions)
        start = np.clip(one.size, -spread, spread)
        best = solved([case], directions, spread, found.friction, start)
        if len(spread) == 1 and _left(best, spread) > _POOR * len(misfit.value):
            best = min(
                best,
                solved([case], directions, spread, found.friction, -start),
                key=lambda solution: _left(solution, spread),
            )
        explained = none - _left(best, spread)
        moved = own @ (directions @ best.size)
        out.append(
            Tried(
                explained - _PRICE * (len(spread) - 1),
                one.suspect,
                best.size,
                np.sqrt(np.diag(best.covariance)),
                explained,
                moved,
            )
        )
    return sorted(out, key=lambda one: -one.score) or first


def _left(solution: Solution, spread: Float[np.ndarray, "p"]) -> float:
    misfit = solution.misfits[0]
    return float(misfit.value @ misfit.value + np.sum((solution.size / spread) ** 2))
