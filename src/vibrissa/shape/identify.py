"""Which of several known objects contacts belong to.

Each object is located, and compared by its evidence: the probability of the contacts in any pose,
where all poses are equally likely beforehand (MacKay, *Information Theory, Inference, and Learning
Algorithms*, 2003, chapter 28). Around each pose that fits, the integral is that of a Gaussian
(Laplace), times the turns that are free.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from vibrissa.contacts import Contacts
from vibrissa.shape.locate import Location, located
from vibrissa.shape.sites import assumptions, gathered
from vibrissa.surfaces import Surface

_DOUBTFUL = 0.05
"""Probability of another object than the best above which a word is due."""


class Candidate(NamedTuple):
    """An object that contacts may belong to."""

    name: str
    """As it was given."""
    probability: float
    """That it is this one, given that it is one of those compared."""
    location: Location
    """Its poses that fit."""


@dataclass(frozen=True, eq=False)
class Identification:
    """Known objects that contacts may belong to, the most probable first.

    Attributes
    ----------
    candidates
        Each object that could be located, with its probability and its poses.
    failed
        Why the others could not be, by name.
    warnings
        One line if none fits, if several can hardly be told apart, and for each that failed.
    """

    candidates: list[Candidate]
    failed: dict[str, str]
    warnings: list[str]

    def __repr__(self) -> str:
        """Return one line for each object."""
        lines = [f"Identification among {len(self.candidates)} objects"]
        for name, probability, location in self.candidates:
            misfit = location.poses[0].misfit
            lines.append(
                f"  {name}: probability {probability:.3g}, misfit {misfit:.3g} of "
                f"{location.freedom} degrees of freedom"
            )
        return "\n".join(lines + [f"  {name}: {why}" for name, why in self.failed.items()])

    @property
    def name(self) -> str:
        """Of the most probable object."""
        return self.candidates[0].name

    @property
    def probability(self) -> float:
        """Of the most probable object."""
        return self.candidates[0].probability

    @property
    def location(self) -> Location:
        """Of the most probable object."""
        return self.candidates[0].location


def identify(
    surfaces: Mapping[str, Surface] | Sequence[Surface],
    contacts: Contacts | Sequence[Contacts],
) -> Identification:
    """Which of several known objects was touched, and where it is.

    Parameters
    ----------
    surfaces
        Objects by name, each in its own axes about their origin; those of a list are named by
        their numbers from 0.
    contacts
        As for `locate`.

    Returns
    -------
    Identification
        Objects with probabilities that add up to one, each with its poses, and warnings.

    Raises
    ------
    ValueError
        If there are no objects, fewer than three contacts can be used, or no object can be located.
        One that cannot is named in `failed`, and does not count.

    Notes
    -----
    Probabilities hold for one of these objects, each as likely as any other beforehand, with the
    errors that the contacts state. Where an object was touched says nothing, only whether it fits.
    """
    named = dict(surfaces) if isinstance(surfaces, Mapping) else _numbered(surfaces)
    if not named:
        raise ValueError("surfaces: none given; allowed is at least one")
    given, found, failed = gathered(contacts), dict[str, Location](), dict[str, str]()
    for name, surface in named.items():
        try:
            location = located(surface, given)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            failed[name] = str(error)
            continue
        if np.isfinite(location.log_evidence):
            found[name] = location
        else:
            failed[name] = "its level is not finite at the contacts"
    if not found:
        reasons = "; ".join(f"{name}: {why}" for name, why in failed.items())
        raise ValueError(f"surfaces: none can be located ({reasons})")
    chances = softmax([each.log_evidence for each in found.values()]).tolist()
    ranked = sorted(
        map(Candidate, found, chances, found.values()), key=lambda one: -one.location.log_evidence
    )
    return Identification(ranked, failed, assumptions(given) + _warnings(ranked, failed))


def _numbered(surfaces: Sequence[Surface]) -> dict[str, Surface]:
    return {str(number): surface for number, surface in enumerate(surfaces)}


def _warnings(ranked: list[Candidate], failed: dict[str, str]) -> list[str]:
    """What to know before the first is believed."""
    first, lines = ranked[0], list[str]()
    if all(each.location.warnings for each in ranked):
        lines.append(f"none of the objects fits; of {first.name}, {first.location.warnings[0]}")
    others = [each for each in ranked[1:] if each.probability > _DOUBTFUL]
    if others:
        told = ", ".join(f"{each.name} ({each.probability:.2g})" for each in [first, *others])
        lines.append(f"the contacts hardly tell these objects apart: {told}")
    return lines + [f"{name} was left out: {why}" for name, why in failed.items()]
