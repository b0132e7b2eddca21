"""Carefully resolve one stretch of one trail, where the march lost a lane."""

from dataclasses import dataclass, field

import numpy as np

from vibrissa.contact import Law, Reached, Scene, State
from vibrissa.contacts import Status
from vibrissa.forward.approach import (
    CLEAR,
    HEAD_ON_COSINE,
    Meeting,
    clearances,
    meetings_on,
    neutral,
)
from vibrissa.forward.events import EventKind
from vibrissa.forward.locate import Place
from vibrissa.forward.march import Mode
from vibrissa.forward.path import Stretch, chosen
from vibrissa.forward.search import ENERGY_MARGIN, Settled, lowest_equilibrium
from vibrissa.forward.ways import NO_FORCE, Branch, End, Happened, LostError, Rubbing
from vibrissa.mechanics.model import Clamp

_AFTER_CONTACT = (1e-3, 1e-2, 0.1, 1.0)
"""Fractions of a stretch past a first contact at which its equilibrium is searched for."""
_MOST_CHANGES = 12
"""Most losses and renewals of contact on one stretch; more count as chatter."""
_PROGRESS = 1e-9
"""Fraction of the stretch that a contact must last for its end to count; less is rounding."""


@dataclass
class Outcome:
    """How a stretch ended: mode, state, figure (as in `Steps`) and phase at its end, what happened
    on it, and a status if it failed.
    """

    mode: Mode
    reached: Reached | None = None
    figure: float = np.nan
    phase: float = np.nan
    happened: list[Happened] = field(default_factory=list)
    status: Status = Status.OK


def follow(
    scene: Scene, law: Law, stretch: Stretch, mode: Mode, reached: Reached | None
) -> Outcome:
    """Resolve a stretch that starts in mode FREE or CONTACT (with what was reached there); in mode
    LOST nothing is known of its start, and only its end is solved.
    """
    return _Follower(scene, law, stretch).follow(mode, reached)


class _Follower:
    def __init__(self, scene: Scene, law: Law, stretch: Stretch) -> None:
        self._scene, self._law, self._stretch = scene, law, stretch
        self._way = (Branch if law.branch else Rubbing)(scene, law, stretch)
        self._happened: list[Happened] = []

    def follow(self, mode: Mode, reached: Reached | None) -> Outcome:
        fraction = 0.0
        here = self._way.enter(reached) if mode == Mode.CONTACT and reached is not None else None
        if mode == Mode.LOST or (mode == Mode.CONTACT and here is None):
            return self._anew(EventKind.STARTED_IN_CONTACT)
        for _ in range(_MOST_CHANGES):
            if here is None:
                met = self._first_contact(fraction)
                if met is None:
                    return Outcome(Mode.FREE, happened=self._happened)
                if met.cosine < HEAD_ON_COSINE and self._neutral(met):
                    self._happened.append((EventKind.HEAD_ON, float(met.fraction), met.point))
                    return self._failed(Status.HEAD_ON)
                self._happened.append((EventKind.FIRST_CONTACT, float(met.fraction), met.point))
                here = self._way.met(met)
                if here is None:
                    return self._failed(Status.NOT_CONVERGED)
            since = here.fraction
            end = self._way.track(here, self._happened)
            if end.reason == "arrived":
                return self._arrived(end.at)
            if end.reason == "stuck":
                break
            try:
                here, fraction = self._behind(end, since)
            except LostError:
                return self._anew()
        return self._anew(EventKind.STARTED_IN_CONTACT)

    def _behind(self, end: End, since: float) -> tuple[Place | None, float]:
        """Where the lane goes on after a contact that began at `since` has ended, and from which
        fraction: at another equilibrium, or free (None).
        """
        fraction, state = end.at.fraction, end.at.reached.state
        unloaded = state.force <= NO_FORCE
        leaving = unloaded and self._clear(min(1.0, fraction + _AFTER_CONTACT[0]))
        if leaving or ((unloaded or end.reason == "released") and fraction - since > _PROGRESS):
            self._happened.append((EventKind.DETACH, fraction, state.point))
            return None, fraction
        if unloaded:
            # The free rod met the object along a line or at an edge: the contact begins
            # somewhere other than where it was first seen.
            for ahead in _AFTER_CONTACT:
                at = min(1.0, fraction + ahead)
                here = self._settled(at, np.inf, self._way.leaving(end.at))
                if here is not None:
                    return here, at
            raise LostError
        self._happened.append((EventKind.SNAP, fraction, state.point))
        if self._clear(fraction):
            return None, fraction
        energy = self._way.energy(end.at) - ENERGY_MARGIN
        here = self._settled(fraction, energy, self._way.leaving(end.at))
        if here is None and not self._clear(1.0):
            raise LostError
        # If there is none, whatever is left of the contact ends before the next position.
        return here, 1.0 if here is None else fraction

    def _clearance(self, fraction: float) -> float:
        clamps = self._stretch.clamps(np.array([fraction]))
        return float(clearances(self._scene, Clamp(*(part[None] for part in clamps))).distance[0])

    def _clear(self, fraction: float) -> bool:
        return self._clearance(fraction) >= CLEAR

    def _neutral(self, met: Meeting) -> bool:
        """Whether a rod that is met along its own tangent is straight."""
        clamps = self._stretch.clamps(np.array([met.fraction]))
        along = Clamp(*(part[None] for part in clamps))
        return bool(neutral(self._scene, along, -met.tangent[None])[0])

    def _first_contact(self, fraction: float) -> Meeting | None:
        """Next first contact of the free rod between a fraction and the end, if any."""
        before, after = self._clearance(fraction), self._clearance(1.0)
        if after >= CLEAR:
            return None
        rest = self._stretch.part(np.array([[fraction]]), np.ones((1, 1)))
        met = chosen(meetings_on(self._scene, rest, np.array([before]), np.array([after])), 0)
        return Meeting(fraction + (1 - fraction) * met.fraction, *met[1:])

    def _found(self, fraction: float, energy: float, near: State | None) -> Settled | None:
        """The stable frictionless equilibrium of least energy, if that energy is below `energy`."""
        clamp = self._stretch.clamps(np.array([fraction]))
        found = lowest_equilibrium(self._scene, clamp, near)
        return found if found is not None and found.energy < energy else None

    def _settled(self, fraction: float, energy: float, near: State | None) -> Place | None:
        found = self._found(fraction, energy, near)
        return None if found is None else self._way.settled(found, fraction)

    def _anew(self, happening: EventKind | None = None) -> Outcome:
        """Restart the lane at the end of the stretch, whatever came before. It is lost if there is
        no equilibrium, or if the side to which the rod bends depends on its past.
        """
        found = self._found(1.0, np.inf, None)
        if found is None or found.neutral:
            return self._failed(Status.NO_EQUILIBRIUM if found is None else Status.HEAD_ON)
        here = self._way.settled(found, 1.0)
        if here is None:
            return self._failed(Status.NO_EQUILIBRIUM)
        if happening is not None:
            self._happened.append((happening, 1.0, here.reached.state.point))
        return self._arrived(here)

    def _arrived(self, at: Place) -> Outcome:
        return Outcome(Mode.CONTACT, at.reached, at.figure, at.phase, self._happened)

    def _failed(self, status: Status) -> Outcome:
        return Outcome(Mode.LOST, happened=self._happened, status=status)
