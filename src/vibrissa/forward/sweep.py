"""The sweep: geometry of the straight rod, the march, and `follow` wherever the march lost a lane;
then the events.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import Status
from vibrissa.forward.equations import Scene
from vibrissa.forward.events import EventKind, Happening
from vibrissa.forward.landing import CLEAR, Outcome
from vibrissa.forward.laws import ContactLaw
from vibrissa.forward.locate import Indicator
from vibrissa.forward.march import Legs, Mode
from vibrissa.forward.meetings import Meetings, along_trails, first_meetings
from vibrissa.forward.path import Path, extended_back, stretch
from vibrissa.numerics.blocks import WIDE, from_blocks, rounded_up, runs, to_blocks

_STABLE = -1.0
_WAY_BACK = 40


@dataclass
class Sweep:
    """What the solver knows of all positions (m, n), model units."""

    x: Float[np.ndarray, "m n size"]
    mode: Int[np.ndarray, "m n"]
    figure: Float[np.ndarray, "m n"]
    """As in `Steps`."""
    phase: Float[np.ndarray, "m n"]
    status: Int[np.ndarray, "m n"]
    happenings: list[Happening] = field(default_factory=list)


def sweep(scene: Scene, path: Path, law: ContactLaw) -> Sweep:
    """Equilibria at all positions of the path, and the events between them."""
    distance, at_clamp = along_trails(scene, path)
    inside = at_clamp < 0
    clear = (distance >= CLEAR) & ~inside
    meetings = first_meetings(scene, path, clear, distance)
    walk = _Walk(scene, path, law, clear, inside, meetings)
    walk.begin()
    while walk.pending:
        walk.march()
    result = walk.result
    result.happenings += _smooth_happenings(scene, path, law, result, meetings, walk.by_hand)
    result.happenings = [
        happening
        for happening in result.happenings
        if np.isfinite([happening.fraction, *happening.point]).all()
    ]
    result.happenings.sort(key=_order)
    result.happenings = _once(result.happenings)
    return result


def _order(happening: Happening) -> tuple[int, int, float, bool]:
    """By place; the beginning and the end of a contact, in their own order, come before a change of
    phase at the same place, whichever way rounding has it.
    """
    return (
        happening.lane,
        happening.index,
        round(happening.fraction, 12),
        happening.kind not in (EventKind.FIRST_CONTACT, EventKind.DETACH),
    )


def _once(happenings: list[Happening]) -> list[Happening]:
    """Drop changes into a phase that the lane is in already: at a position that lies on a change,
    rounding may report it on both sides.
    """
    kept: list[Happening] = []
    last: dict[int, EventKind] = {}
    for happening in happenings:
        if happening.kind in (EventKind.TIP_TO_TANGENTIAL, EventKind.TANGENTIAL_TO_TIP):
            if last.get(happening.lane) == happening.kind:
                continue
            last[happening.lane] = happening.kind
        elif happening.kind not in (EventKind.LATERAL_INSTABILITY, EventKind.LATERAL_RECOVERY):
            last.pop(happening.lane, None)
        kept.append(happening)
    return kept


class _Start(NamedTuple):
    lane: int
    step: int
    mode: Mode
    x: Float[np.ndarray, "size"]
    sign: float
    patience: int
    """Positions to pass over after the next failure of a search, doubled each time."""


class _Walk:
    """The lanes still on their way, and what has been found so far."""

    def __init__(
        self,
        scene: Scene,
        path: Path,
        law: ContactLaw,
        clear: Bool[np.ndarray, "m n"],
        inside: Bool[np.ndarray, "m n"],
        meetings: Meetings,
    ) -> None:
        m, n = clear.shape
        self._scene, self._path, self._law, self._clear, self._inside = (
            scene,
            path,
            law,
            clear,
            inside,
        )
        self._met = np.zeros((m, n), dtype=bool)
        self._met[meetings.lane, meetings.step] = True
        self._meeting = np.zeros((m, n, law.size))
        self._meeting[meetings.lane, meetings.step] = law.states_at(meetings)
        self.by_hand = np.zeros((m, n), dtype=bool)
        self.pending: list[_Start] = []
        nothing = np.full((m, n), np.nan)
        self.result = Sweep(
            np.full((m, n, law.size), np.nan),
            np.full((m, n), int(Mode.FREE)),
            nothing,
            nothing.copy(),
            np.zeros((m, n), dtype=np.int64),
        )

    def begin(self) -> None:
        """Start every lane at its first position: free, or in contact already."""
        entered = _entered(
            self._scene,
            self._path,
            self._law,
            np.flatnonzero(~self._clear[:, 0] & ~self._inside[:, 0]),
        )
        for lane in range(len(self._clear)):
            if self._clear[lane, 0]:
                self.pending.append(self._free(lane, 0))
            elif lane in entered:
                self._settle(lane, 0, entered[lane], 1)
            else:
                self._resolve(lane, 0, Mode.LOST, self._unknown(), 1)

    def _free(self, lane: int, index: int) -> _Start:
        return _Start(lane, index, Mode.FREE, np.zeros(self._law.size), _STABLE, 1)

    def _unknown(self) -> Float[np.ndarray, "size"]:
        return np.full(self._law.size, np.nan)

    def start_at(self, first: Int[np.ndarray, "m"]) -> None:
        """Start every lane free at a given position."""
        self.pending = [self._free(lane, int(index)) for lane, index in enumerate(first)]

    def march(self, *, resolve: bool = True) -> None:
        """March all pending lanes to their ends, or to where they are lost; resolve those, or leave
        them.
        """
        starts, self.pending = self.pending, []
        lanes = np.array([start.lane for start in starts])
        first = np.array([start.step for start in starts])
        x, mode, figure, phase = self._marched(starts, lanes)
        n = mode.shape[1]
        own = np.arange(n) >= first[:, None]
        lost = own & (mode == Mode.LOST)
        ends = np.where(lost.any(axis=1), lost.argmax(axis=1), n)
        kept = own & (np.arange(n) < ends[:, None])
        # The first row of a resumed lane was found by hand, with its figure and phase.
        kept &= (np.arange(n) > first[:, None]) | (mode == Mode.FREE)
        rows = np.nonzero(kept)
        at = (lanes[rows[0]], rows[1])
        for target, source in (
            (self.result.x, x),
            (self.result.mode, mode),
            (self.result.figure, figure),
            (self.result.phase, phase),
        ):
            target[at] = source[rows]
        self.result.mode[lanes[ends < n], ends[ends < n]] = int(Mode.LOST)
        for row in np.flatnonzero(ends < n) if resolve else ():
            lane, index = int(lanes[row]), int(ends[row])
            before = Mode(int(self.result.mode[lane, index - 1])) if index else Mode.LOST
            self._resolve(lane, index, before, self.result.x[lane, index - 1], starts[row].patience)

    def _marched(self, starts: list[_Start], lanes: Int[np.ndarray, "k"]) -> tuple[np.ndarray, ...]:
        width = 1 if len(starts) == 1 else WIDE
        parts = [
            self._marched_run(starts[first:last], lanes[first:last], width, blocks)
            for first, last, blocks in runs(len(starts), width, self._scene.sizes)
        ]
        return tuple(
            np.concatenate(columns) if len(parts) > 1 else columns[0]
            for columns in zip(*parts, strict=True)
        )

    def _marched_run(
        self, starts: list[_Start], lanes: Int[np.ndarray, "k"], width: int, blocks: int
    ) -> tuple[np.ndarray, ...]:
        n = self._clear.shape[1]
        capacity = rounded_up(n)

        def lane_blocks(rows: np.ndarray) -> np.ndarray:
            return to_blocks(rows, width, blocks)

        def position_blocks(rows: np.ndarray) -> np.ndarray:
            padded = np.zeros((len(rows), capacity, *rows.shape[2:]), dtype=rows.dtype)
            padded[:, :n] = rows
            return to_blocks(padded, width, blocks)

        legs = Legs(
            point=position_blocks(self._path.point[lanes]),
            tangent=position_blocks(self._path.tangent[lanes]),
            clear=position_blocks(self._clear[lanes]),
            met=position_blocks(self._met[lanes]),
            meeting=position_blocks(self._meeting[lanes]),
            start=lane_blocks(np.array([start.step for start in starts])),
            mode=lane_blocks(np.array([int(start.mode) for start in starts])),
            x=lane_blocks(np.array([start.x for start in starts])),
            sign=lane_blocks(np.array([start.sign for start in starts])),
        )
        steps = self._law.march(
            self._scene, legs, np.asarray(n), np.asarray(-(-len(starts) // width))
        )
        return tuple(from_blocks(np.asarray(part), len(starts))[:, :n] for part in steps)

    def _resolve(
        self, lane: int, index: int, mode: Mode, x: Float[np.ndarray, "size"], patience: int
    ) -> None:
        """Settle the stretch that ends at `index` and let the lane go on behind it."""
        if self._inside[lane, index]:
            outcome = Outcome(Mode.LOST, self._unknown(), status=Status.CLAMP_INSIDE)
        elif mode in (Mode.LOST, Mode.WAITING) and self._clear[lane, index]:
            outcome = Outcome(Mode.FREE, np.zeros(self._law.size))
        else:
            outcome = self._followed(lane, index, mode, x)
        self._settle(lane, index, outcome, patience)

    def _followed(self, lane: int, index: int, mode: Mode, x: Float[np.ndarray, "size"]) -> Outcome:
        try:
            return self._law.follow(self._scene, stretch(self._path, lane, index), mode, x)
        except (ArithmeticError, ValueError):
            # Numbers that a library refuses, such as an eigenvalue that does not converge, are one
            # lane's failure: the others keep their results.
            return Outcome(Mode.LOST, self._unknown(), status=Status.NOT_CONVERGED)

    def _settle(self, lane: int, index: int, outcome: Outcome, patience: int) -> None:
        result = self.result
        self.by_hand[lane, index] = True
        result.x[lane, index], result.mode[lane, index] = outcome.x, int(outcome.mode)
        result.figure[lane, index], result.phase[lane, index] = outcome.figure, outcome.phase
        result.status[lane, index] = int(outcome.status)
        result.happenings += [
            Happening(kind, lane, index, fraction, np.asarray(point))
            for kind, fraction, point in outcome.happened
        ]
        if outcome.mode == Mode.LOST:
            self._pass_over(lane, index, outcome.status, patience)
        else:
            sign = float(np.sign(outcome.figure)) if outcome.mode == Mode.CONTACT else _STABLE
            self._go_on(_Start(lane, index, outcome.mode, outcome.x, sign, patience))

    def _go_on(self, start: _Start) -> None:
        if start.step < self._clear.shape[1] - 1:
            self.pending.append(start)

    def _pass_over(self, lane: int, index: int, status: Status, patience: int) -> None:
        """Give the rows behind a failure its status, up to where the straight rod is clear again or
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
        self.result.mode[lane, index + 1 : stop] = int(Mode.LOST)
        self.result.status[lane, index + 1 : stop] = np.where(
            self._inside[lane, index + 1 : stop], int(Status.CLAMP_INSIDE), int(status)
        )
        self.by_hand[lane, index + 1 : stop + 1] = True
        if stop < n:
            self._resolve_later(lane, stop, patience * 2)

    def _resolve_later(self, lane: int, index: int, patience: int) -> None:
        self._resolve(lane, index, Mode.LOST, self._unknown(), patience)


def _entered(
    scene: Scene, path: Path, law: ContactLaw, lanes: Int[np.ndarray, "k"]
) -> dict[int, Outcome]:
    """Lanes that begin in contact, as if their first step had come from outside the object; those
    for which that goes smoothly.
    """
    if not len(lanes) or path.point.shape[1] < 2:
        return {}
    way = extended_back(path, lanes, _WAY_BACK)
    distance, at_clamp = along_trails(scene, way)
    clear = (distance >= CLEAR) & (at_clamp >= 0)
    last_clear = clear.shape[1] - 1 - np.argmax(clear[:, ::-1], axis=1)
    found = np.flatnonzero(clear.any(axis=1))
    if not len(found):
        return {}
    # Only the part of the way that some lane needs.
    from_ = int(last_clear[found].min())
    way = Path(way.point[found, from_:], way.orientation[found, from_:], 1)
    clear, inside = clear[found, from_:], at_clamp[found, from_:] < 0
    walk = _Walk(
        scene, way, law, clear, inside, first_meetings(scene, way, clear, distance[found, from_:])
    )
    walk.start_at(last_clear[found] - from_)
    walk.march(resolve=False)
    x, mode, figure, phase = (
        part[:, -1]
        for part in (walk.result.x, walk.result.mode, walk.result.figure, walk.result.phase)
    )
    return {
        int(lanes[row]): Outcome(
            Mode.CONTACT, x[k], figure[k], phase[k], [(EventKind.STARTED_IN_CONTACT, 1.0, x[k, :3])]
        )
        for k, row in enumerate(found)
        if mode[k] == Mode.CONTACT and (figure[k] < 0 or not law.branch)
    }


class _Bracket(NamedTuple):
    kind: EventKind
    indicator: Indicator
    lane: int
    step: int
    ends: Float[np.ndarray, "ends"]


def _smooth_happenings(
    scene: Scene,
    path: Path,
    law: ContactLaw,
    result: Sweep,
    meetings: Meetings,
    by_hand: Bool[np.ndarray, "m n"],
) -> list[Happening]:
    """Events on stretches that the march passed without help."""
    contact = result.mode == Mode.CONTACT
    entered = contact[meetings.lane, meetings.step] & ~by_hand[meetings.lane, meetings.step]
    entered &= ~contact[meetings.lane, meetings.step - 1]
    happenings, brackets = [], []
    met = Meetings(*(part[entered] for part in meetings))
    for lane, index, fraction, state, phase in zip(
        met.lane, met.step, met.fraction, law.states_at(met), met.phase, strict=True
    ):
        happenings.append(
            Happening(EventKind.FIRST_CONTACT, int(lane), int(index), float(fraction), state[:3])
        )
        after = result.phase[lane, index]
        if (phase > 0) != (after > 0):
            ends = np.concatenate([[fraction], state, [phase, 1.0], result.x[lane, index], [after]])
            brackets.append(_Bracket(_change(after), Indicator.PHASE, int(lane), int(index), ends))
    before, after = contact[:, :-1], contact[:, 1:]
    marched = ~by_hand[:, 1:]
    changed = marched & before & ((result.phase[:, :-1] > 0) != (result.phase[:, 1:] > 0))
    changed &= after | (result.mode[:, 1:] == Mode.FREE)
    released = marched & before & (result.mode[:, 1:] == Mode.FREE)
    for lane, index in _ends_of_steps(changed):
        ends = _ends(result, lane, index, result.phase[lane, index - 1], result.phase[lane, index])
        brackets.append(
            _Bracket(_change(result.phase[lane, index]), Indicator.PHASE, lane, index, ends)
        )
    if not law.branch:
        slid, slides = result.figure[:, :-1] > 0, result.figure[:, 1:] > 0
        for lane, index in _ends_of_steps(marched & before & after & (slid != slides)):
            ends = _ends(
                result, lane, index, result.figure[lane, index - 1], result.figure[lane, index]
            )
            kind = (
                EventKind.STICK_TO_SLIP
                if result.figure[lane, index] > 0
                else EventKind.SLIP_TO_STICK
            )
            brackets.append(_Bracket(kind, Indicator.CONE, lane, index, ends))
    for lane, index in _ends_of_steps(released):
        ends = _ends(result, lane, index, result.x[lane, index - 1, 3], result.x[lane, index, 3])
        brackets.append(_Bracket(EventKind.DETACH, Indicator.FORCE, lane, index, ends))
    return happenings + _located(scene, path, law, brackets)


def _ends_of_steps(chosen: Bool[np.ndarray, "m steps"]) -> list[tuple[int, int]]:
    """Lane and index of the position at the end of each chosen step."""
    return [(int(lane), int(step) + 1) for lane, step in np.argwhere(chosen)]


def _change(phase: float) -> EventKind:
    return EventKind.TIP_TO_TANGENTIAL if phase > 0 else EventKind.TANGENTIAL_TO_TIP


def _ends(
    result: Sweep, lane: int, index: int, before: float, after: float
) -> Float[np.ndarray, "ends"]:
    return np.concatenate(
        [[0.0], result.x[lane, index - 1], [before, 1.0], result.x[lane, index], [after]]
    )


def _located(
    scene: Scene, path: Path, law: ContactLaw, brackets: list[_Bracket]
) -> list[Happening]:
    if not brackets:
        return []
    lanes = np.array([bracket.lane for bracket in brackets])
    indices = np.array([bracket.step for bracket in brackets])
    ends = np.array([bracket.ends for bracket in brackets])
    indicator = np.array([int(bracket.indicator) for bracket in brackets])
    found = law.roots(scene, stretch(path, lanes, indices), ends, indicator)
    release = {
        (b.lane, b.step): row[0]
        for b, row in zip(brackets, found, strict=True)
        if b.kind == EventKind.DETACH
    }
    return [
        Happening(b.kind, b.lane, b.step, float(row[0]), row[1:4])
        for b, row in zip(brackets, found, strict=True)
        # A change of phase behind the loss of contact belongs to no rod.
        if b.kind == EventKind.DETACH or row[0] < release.get((b.lane, b.step), np.inf)
    ]
