"""The sweep: geometry of the free rod, and the march; where that has lost a lane, the march through
the divided stretch and, failing that, `follow`; then the events.
"""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contact import Law, Reached, Scene
from vibrissa.contacts import Status
from vibrissa.forward.approach import (
    CLEAR,
    Clearance,
    Meeting,
    Meetings,
    along_path,
    begun,
    first_meetings,
)
from vibrissa.forward.events import EventKind, Happening
from vibrissa.forward.follow import Outcome, follow
from vibrissa.forward.locate import Indicator, Place, located
from vibrissa.forward.march import STABLE, Mode, Steps, entering, march, nowhere
from vibrissa.forward.path import Path, chosen, divided, extended_back
from vibrissa.forward.ways import Happened
from vibrissa.geometry.rotation import lengths
from vibrissa.numerics.progress import Tally

_AT_ONCE = 1e-9
"""Fraction of a step within which events count as one, to rounding."""
_WAY_BACK = 40
"""Steps of 0.05 L by which a lane that begins in contact is extended backwards: two rod lengths."""
_PARTS = 32
"""Into how many parts a stretch is divided on which the march has lost a lane."""
_STEADY, _STEADY_FLOOR = 2.5, 0.0025
"""There a contact moves on steadily if it moves on no part more than this many times as far as on
those before and behind, or than this [L]: where it jumps, it is slower before or behind.
"""


@dataclass
class Sweep:
    """What the solver knows about all positions (m, n), in model units."""

    steps: Steps
    status: Int[np.ndarray, "m n"]
    happenings: list[Happening] = field(default_factory=list)


def sweep(scene: Scene, path: Path, law: Law, tally: Tally) -> Sweep:
    """Equilibria at all positions of the path, which are tallied, and the events between them."""
    straight = along_path(scene, path)
    walk = _Walk(scene, path, law, straight, tally)
    walk.begin()
    while walk.pending:
        walk.march()
    found = walk.found
    found.steps.mode[~straight.sound] = int(Mode.LOST)
    found.status[~straight.sound] = int(Status.FALLS_OVER)
    found.happenings += walk.smooth_happenings()
    found.happenings = _in_order(found.happenings)
    return found


def _in_order(happenings: list[Happening]) -> list[Happening]:
    """Sorted by place, without duplicates."""
    lasting = (EventKind.FIRST_CONTACT, EventKind.DETACH)
    finite = [at for at in happenings if math.isfinite(sum(at.point, start=at.fraction))]
    # At the same place, the beginning and the end of a contact, in their own order, come before a
    # change of phase, whichever way rounding puts them.
    finite.sort(key=lambda at: (at.lane, at.index, round(at.fraction, 12), at.kind not in lasting))
    kept: list[Happening] = []
    last: dict[int, EventKind] = {}
    for at in finite:
        # Skip a change into the phase that the lane is in already: at a position right on a change,
        # rounding may report it on both sides.
        if at.kind in (EventKind.TIP_TO_TANGENTIAL, EventKind.TANGENTIAL_TO_TIP):
            if last.get(at.lane) == at.kind:
                continue
            last[at.lane] = at.kind
        elif at.kind not in (EventKind.LATERAL_INSTABILITY, EventKind.LATERAL_RECOVERY):
            last.pop(at.lane, None)
        kept.append(at)
    return kept


class _Start(NamedTuple):
    lane: int
    position: int
    mode: Mode
    reached: Reached | None
    sign: float
    patience: int
    """Positions to skip after the next failed search, doubled each time."""


def _started(
    lane: int, position: int, mode: Mode, reached: Reached | None, figure: float, patience: int
) -> _Start:
    """A lane on the branch that the figure tells."""
    sign = float(np.sign(figure)) if mode == Mode.CONTACT else STABLE
    return _Start(lane, position, mode, reached, sign, patience)


class _Walk:
    """The lanes still to be marched, and what has been found so far."""

    def __init__(
        self,
        scene: Scene,
        path: Path,
        law: Law,
        straight: Clearance,
        tally: Tally | None = None,
        *,
        guarded: bool = True,
    ) -> None:
        # Where a rod has no shape of its own, nothing can be followed.
        inside = (straight.at_clamp < 0) | ~straight.sound
        clear = (straight.distance >= CLEAR) & ~inside
        self._scene, self._path, self._law, self._guarded = scene, path, law, guarded
        self._clear, self._inside = clear, inside
        self._meetings = first_meetings(scene, path, clear, straight.distance)
        shape = clear.shape
        self._tally, self._left = tally or Tally(None, 0), np.full(shape[0], shape[1])
        self.by_hand = np.zeros(shape, dtype=bool)
        self.pending: list[_Start] = []
        nothing = np.full(shape, np.nan)
        free = np.full(shape, int(Mode.FREE))
        steps = Steps(nowhere(scene, law, *shape), free, *(nothing.copy() for _ in range(3)))
        self.found = Sweep(steps, np.zeros(shape, dtype=np.int64))

    def begin(self) -> None:
        """Start every lane at its first position: free, or already in contact."""
        touching = np.flatnonzero(~self._clear[:, 0] & ~self._inside[:, 0])
        entered = _entered(self._scene, self._path, self._law, touching)
        for lane, clear in enumerate(self._clear[:, 0]):
            if clear:
                self.pending.append(_Start(lane, 0, Mode.FREE, None, STABLE, 1))
            elif lane in entered:
                self._settle(lane, 0, entered[lane], 1)
            else:
                self._resolve(lane, 0, Mode.LOST, 1)

    def start_at(self, first: Int[np.ndarray, "m"]) -> None:
        """Start every lane free at a given position."""
        self.pending = [
            _Start(lane, int(index), Mode.FREE, None, STABLE, 1) for lane, index in enumerate(first)
        ]

    def resume(self, before: Steps) -> None:
        """Start every lane at its first position with what is known there (k, …)."""
        for lane, mode in enumerate(before.mode.tolist()):
            own = chosen(before, lane)
            self.pending.append(_started(lane, 0, Mode(mode), own.reached, own.figure, 1))
        for whole, part in zip(
            jax.tree.leaves(self.found.steps), jax.tree.leaves(before), strict=True
        ):
            whole[:, 0] = part

    def march(self, *, resolve: bool = True) -> None:
        """March all pending lanes to their ends, or to where they are lost, and resolve those
        unless told otherwise.
        """
        starts, self.pending = self.pending, []
        lanes = np.array([start.lane for start in starts])
        first = np.array([start.position for start in starts])
        steps = self._marched(starts, lanes, first)
        n = self._clear.shape[1]
        own = np.arange(n) >= first[:, None]
        lost = own & (steps.mode == Mode.LOST)
        ends = np.where(lost.any(axis=1), lost.argmax(axis=1), n)
        kept = own & (np.arange(n) < ends[:, None])
        # The first row of a resumed lane was found by hand, with its figure and phase.
        kept &= (np.arange(n) > first[:, None]) | (steps.mode == Mode.FREE)
        for whole, part in zip(
            jax.tree.leaves(self.found.steps), jax.tree.leaves(steps), strict=True
        ):
            own = whole[lanes]
            np.copyto(own, part, where=kept.reshape(*kept.shape, *(1,) * (part.ndim - 2)))
            whole[lanes] = own
        ends = np.minimum(ends, self._past_a_fold(lanes, first, ends))
        self._go_on(lanes, n - ends)
        failed = np.flatnonzero(ends < n)
        for lane, end in zip(lanes[failed], ends[failed], strict=True):
            # What lies behind a fold that was passed over is to be marched anew.
            self.found.steps.mode[lane, end:] = int(Mode.LOST)
        if not resolve:
            return
        smooth = self._divided(lanes[failed], ends[failed])
        for which in failed.tolist():
            lane, at, patience = int(lanes[which]), int(ends[which]), starts[which].patience
            if lane in smooth:
                self._settle(lane, at, smooth[lane], patience)
            else:
                before = Mode(int(self.found.steps.mode[lane, at - 1])) if at else Mode.LOST
                self._resolve(lane, at, before, patience)

    def _past_a_fold(
        self, lanes: Int[np.ndarray, "k"], first: Int[np.ndarray, "k"], ends: Int[np.ndarray, "k"]
    ) -> Int[np.ndarray, "k"]:
        """The first position after `first`, and before its end, where each lane may have stepped
        over a fold; n if there is none. With friction there are no folds.
        """
        n = self._clear.shape[1]
        if not self._law.branch or n == 1:
            return np.full(len(lanes), n)
        steps, at = chosen(self.found.steps, lanes), np.arange(n)
        known = (steps.mode == Mode.CONTACT) & (at < ends[:, None])
        points = np.where(known[..., None], steps.reached.state.point, np.nan)
        folds, changed = _folds(np.where(known, steps.figure, np.nan), steps.phase)
        past = np.zeros(known.shape, dtype=bool)
        past[:, 1:] = folds & ~(changed & _steady(points))
        past &= at > first[:, None]
        return np.where(past.any(axis=1), past.argmax(axis=1), n)

    def _go_on(self, lanes: Any, left: Any) -> None:
        """Tally what lanes have passed, given the positions they have left."""
        self._tally.add(int(np.sum(self._left[lanes] - left)))
        self._left[lanes] = left

    def _marched(
        self, starts: list[_Start], lanes: Int[np.ndarray, "k"], first: Int[np.ndarray, "k"]
    ) -> Steps:
        legs = entering(self._scene, self._law, chosen(self._path.clamps, lanes))
        place = np.full(len(self._clear), -1)
        place[lanes] = np.arange(len(starts))
        here = place[self._meetings.lane] >= 0
        at = (place[self._meetings.lane[here]], self._meetings.position[here])
        legs.met[at] = True
        states = begun(chosen(self._meetings.at, here), self._law.unknowns)
        for whole, part in zip(jax.tree.leaves(legs.meeting), jax.tree.leaves(states), strict=True):
            whole[at] = part
        nothing = nowhere(self._scene, self._law, fill=0.0)
        reached = [start.reached or nothing for start in starts]
        legs = legs._replace(
            clear=self._clear[lanes],
            start=first,
            mode=np.array([int(start.mode) for start in starts]),
            reached=jax.tree.map(lambda *parts: np.stack(parts), *reached),
            sign=np.array([start.sign for start in starts]),
            guarded=np.full(len(starts), self._guarded),
        )
        return march(self._scene, self._law, legs)

    def _divided(
        self, lanes: Int[np.ndarray, "k"], ends: Int[np.ndarray, "k"]
    ) -> dict[int, Outcome]:
        """Lanes that pass the stretches that end at given positions if these are divided."""
        steps = self.found.steps
        known = self._law.branch & (ends > 0) & ~self._inside[lanes, ends]
        known &= np.isin(steps.mode[lanes, ends - 1], (Mode.FREE, Mode.CONTACT))
        lanes, ends = lanes[known], ends[known]
        if not len(lanes):
            return {}
        # One part more, to see how it goes on.
        way = divided(self._path.stretch(lanes, ends), _PARTS, 1)
        walk = _Walk(self._scene, way, self._law, along_path(self._scene, way), guarded=False)
        before = chosen(steps, (lanes, ends - 1))
        walk.resume(before)
        walk.march(resolve=False)
        found = walk.found.steps
        steady = _steady(found.reached.state.point).all(axis=1)
        lost = (found.mode == Mode.LOST).any(axis=1) | ~steady
        found.mode[lost] = int(Mode.LOST)
        found.mode[:, _PARTS + 1 :] = int(Mode.WAITING)
        happened: list[list[Happened]] = [[] for _ in lanes]
        for at in _in_order(walk.smooth_happenings()):
            fraction = (at.index - 1 + at.fraction) / _PARTS
            happened[at.lane].append((at.kind, fraction, at.point))
        last = chosen(found, np.s_[:, _PARTS])
        outcomes = {}
        for row in np.flatnonzero(~lost).tolist():
            end = chosen(last, row)
            outcomes[int(lanes[row])] = Outcome(
                Mode(int(end.mode)), end.reached, end.figure, end.phase, happened[row]
            )
        return outcomes

    def smooth_happenings(self) -> list[Happening]:
        """Events on stretches that the march passed without help."""
        return _smooth_happenings(
            self._scene, self._path, self._law, self.found.steps, self._meetings, self.by_hand
        )

    def _resolve(self, lane: int, index: int, mode: Mode, patience: int) -> None:
        """Settle the stretch that ends at `index` and let the lane go on after it."""
        if self._inside[lane, index]:
            outcome = Outcome(Mode.LOST, status=Status.CLAMP_INSIDE)
        elif mode in (Mode.LOST, Mode.WAITING) and self._clear[lane, index]:
            outcome = Outcome(Mode.FREE)
        else:
            reached = chosen(self.found.steps.reached, (lane, index - 1))
            try:
                stretch = self._path.stretch(lane, index)
                outcome = follow(self._scene, self._law, stretch, mode, reached)
            except (ArithmeticError, ValueError):
                # Numbers that a library rejects, as when an eigenvalue does not converge, fail one
                # lane: the others keep their results.
                outcome = Outcome(Mode.LOST, status=Status.NOT_CONVERGED)
        self._settle(lane, index, outcome, patience)

    def _settle(self, lane: int, index: int, outcome: Outcome, patience: int) -> None:
        steps, at = self.found.steps, (lane, index)
        self.by_hand[at] = True
        reached = outcome.reached or nowhere(self._scene, self._law)
        for whole, part in zip(
            jax.tree.leaves(steps.reached), jax.tree.leaves(reached), strict=True
        ):
            whole[at] = part
        steps.mode[at], self.found.status[at] = int(outcome.mode), int(outcome.status)
        steps.figure[at], steps.phase[at] = outcome.figure, outcome.phase
        self.found.happenings += [
            Happening(kind, lane, index, fraction, np.asarray(point))
            for kind, fraction, point in outcome.happened
        ]
        last = self._clear.shape[1] - 1
        self._go_on(lane, last - index)
        if outcome.mode == Mode.LOST:
            self._pass_over(lane, index, outcome.status, patience)
        elif index < last:
            self.pending.append(
                _started(lane, index, outcome.mode, outcome.reached, outcome.figure, patience)
            )

    def _pass_over(self, lane: int, index: int, status: Status, patience: int) -> None:
        """Give the rows after a failure its status, up to where the free rod is clear again or
        another search is due.
        """
        n = self._clear.shape[1]
        clear = np.flatnonzero(self._clear[lane, index + 1 :])
        stop = index + 1 + int(clear[0]) if clear.size else n
        if status not in (Status.HEAD_ON, Status.CLAMP_INSIDE):
            stop = min(stop, index + patience)
        elif status == Status.CLAMP_INSIDE:
            outside = np.flatnonzero(~self._inside[lane, index + 1 :])
            stop = min(stop, index + 1 + int(outside[0])) if outside.size else n
        stop = max(stop, index + 1)
        passed = np.s_[lane, index + 1 : stop]
        self.found.steps.mode[passed] = int(Mode.LOST)
        inside = self._inside[passed]
        self.found.status[passed] = np.where(inside, int(Status.CLAMP_INSIDE), int(status))
        self.by_hand[lane, index + 1 : stop + 1] = True
        self._go_on(lane, n - stop)
        if stop < n:
            self._resolve(lane, stop, Mode.LOST, patience * 2)


def _entered(scene: Scene, path: Path, law: Law, lanes: Int[np.ndarray, "k"]) -> dict[int, Outcome]:
    """Lanes that begin in contact, entered as if their first step had come from outside the object;
    only those for which that goes smoothly.
    """
    if not len(lanes) or path.point.shape[1] < 2:
        return {}
    way = extended_back(path, lanes, _WAY_BACK)
    straight = along_path(scene, way)
    clear = (straight.distance >= CLEAR) & (straight.at_clamp >= 0)
    last_clear = clear.shape[1] - 1 - np.argmax(clear[:, ::-1], axis=1)
    found = np.flatnonzero(clear.any(axis=1))
    if not len(found):
        return {}
    # Only the part of the extension that some lane needs.
    needed = np.s_[found, int(last_clear[found].min()) :]
    way = Path(way.point[needed], way.orientation[needed], 1)
    walk = _Walk(scene, way, law, chosen(straight, needed))
    walk.start_at(last_clear[found] - int(last_clear[found].min()))
    walk.march(resolve=False)
    last = chosen(walk.found.steps, np.s_[:, -1])
    entered = {}
    for row, lane in enumerate(lanes[found]):
        end = chosen(last, row)
        if end.mode == Mode.CONTACT and (end.figure < 0 or not law.branch):
            started = (EventKind.STARTED_IN_CONTACT, 1.0, end.reached.state.point)
            entered[int(lane)] = Outcome(
                Mode.CONTACT, end.reached, end.figure, end.phase, [started]
            )
    return entered


def _steady(points: Float[np.ndarray, "k n 3"]) -> Bool[np.ndarray, "k n-1"]:
    """Whether contacts move on steadily on each step, wherever there are any."""
    moved = np.pad(lengths(np.diff(points, axis=1)), ((0, 0), (1, 1)), constant_values=np.nan)
    beside = np.fmin(moved[:, :-2], moved[:, 2:])
    return ~(moved[:, 1:-1] > _STEADY * np.fmax(beside, _STEADY_FLOOR))


def _folds(
    figure: Float[np.ndarray, "k n"], phase: Float[np.ndarray, "k n"]
) -> tuple[Bool[np.ndarray, "k n-1"], Bool[np.ndarray, "k n-1"]]:
    """Steps on which a determinant would fall to zero, its square being linear near a fold; and
    whether the phase, on which it depends too, changed on the step before.
    """
    square, tangential = figure**2, phase > 0
    ahead = ((0, 0), (1, 0))
    folds = np.pad(2 * square[:, 1:-1] < square[:, :-2], ahead)
    return folds, np.pad(tangential[:, 1:-1] != tangential[:, :-2], ahead)


class _Brackets(NamedTuple):
    """Steps (k, …) on which an indicator crosses zero, given by the position at their end."""

    indicator: Int[np.ndarray, "k"]
    lane: Int[np.ndarray, "k"]
    position: Int[np.ndarray, "k"]
    low: Place
    high: Place


def _smooth_happenings(
    scene: Scene,
    path: Path,
    law: Law,
    steps: Steps,
    meetings: Meetings,
    by_hand: Bool[np.ndarray, "m n"],
) -> list[Happening]:
    """Events on stretches that the march passed without help."""
    contact, free = steps.mode == Mode.CONTACT, steps.mode == Mode.FREE
    lane, index = meetings.lane, meetings.position
    entered = contact[lane, index] & ~by_hand[lane, index] & ~contact[lane, index - 1]
    lane, index, meeting = chosen(meetings, entered)

    def place(lane: np.ndarray, index: np.ndarray, fraction: float) -> Place:
        at = chosen((steps.reached, steps.figure, steps.phase), (lane, index))
        return Place(np.full(len(lane), fraction), *at)

    def between(happened: Bool[np.ndarray, "m n"], indicator: Indicator) -> _Brackets:
        lane, before = np.nonzero(happened)
        ends = place(lane, before, 0.0), place(lane, before + 1, 1.0)
        return _Brackets(np.full(len(lane), int(indicator)), lane, before + 1, *ends)

    before, after = contact[:, :-1] & ~by_hand[:, 1:], contact[:, 1:]
    ends = free[:, 1:]
    changed = (steps.phase[:, :-1] > 0) != (steps.phase[:, 1:] > 0)
    brackets = [
        _at_once(law, lane, index, meeting, place(lane, index, 1.0)),
        between(before & changed & (after | ends), Indicator.PHASE),
        between(before & ends, Indicator.FORCE),
    ]
    if not law.branch:
        turned = (steps.figure[:, :-1] > 0) != (steps.figure[:, 1:] > 0)
        brackets.append(between(before & after & turned, Indicator.CONE))
    firsts = (rows.tolist() for rows in (lane, index, meeting.fraction))
    begins = [
        Happening(EventKind.FIRST_CONTACT, lane, index, fraction, point)
        for lane, index, fraction, point in zip(*firsts, meeting.point, strict=True)
    ]
    every = jax.tree.map(lambda *parts: np.concatenate(parts), *brackets)
    return begins + _located(scene, path, law, every)


def _at_once(
    law: Law, lane: np.ndarray, index: np.ndarray, meeting: Meeting, after: Place
) -> _Brackets:
    """Steps with a first contact on which the phase changes too."""
    unloaded = begun(meeting, law.unknowns)
    stable = np.full(len(lane), STABLE)
    low = Place(meeting.fraction, unloaded, stable, meeting.phase)
    phases = np.full(len(lane), int(Indicator.PHASE))
    changes = (low.phase > 0) != (after.phase > 0)
    brackets: _Brackets = chosen(_Brackets(phases, lane, index, low, after), changes)
    return brackets


def _phase_change(phase: float) -> EventKind:
    return EventKind.TIP_TO_TANGENTIAL if phase > 0 else EventKind.TANGENTIAL_TO_TIP


def _kind(indicator: Indicator, after: float) -> EventKind:
    if indicator == Indicator.FORCE:
        return EventKind.DETACH
    if indicator == Indicator.PHASE:
        return _phase_change(after)
    return EventKind.STICK_TO_SLIP if after > 0 else EventKind.SLIP_TO_STICK


def _located(scene: Scene, path: Path, law: Law, brackets: _Brackets) -> list[Happening]:
    indicator, lane, index, low, high = brackets
    if not len(lane):
        return []
    found = located(scene, law, path.stretch(lane, index), low, high, indicator)
    after = np.take_along_axis(high.indicators, indicator[:, None], axis=1)[:, 0]
    kinds = [_kind(Indicator(at), value) for at, value in zip(indicator, after, strict=True)]
    places = list(zip(lane.tolist(), index.tolist(), strict=True))
    fractions = found.fraction.tolist()
    release = {
        place: fraction
        for kind, place, fraction in zip(kinds, places, fractions, strict=True)
        if kind == EventKind.DETACH
    }
    return [
        Happening(kind, *place, fraction, point)
        for kind, place, fraction, point in zip(
            kinds, places, fractions, found.reached.state.point, strict=True
        )
        # A change of phase at or after the loss of contact is not physical.
        if kind == EventKind.DETACH or fraction < release.get(place, np.inf) - _AT_ONCE
    ]
