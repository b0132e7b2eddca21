"""Following an equilibrium along a stretch: as a branch, by its arc length, so that a fold can be
seen; or, with friction, by steps that only go forward, since the state depends on its history.

Steps are halved where Newton's method does not converge.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import Array, lax
from jaxtyping import Float

from vibrissa.contact import FRICTIONLESS, Law, Reached, Scene, State, signed, touching
from vibrissa.forward.approach import Meeting, clearances
from vibrissa.forward.assess import Assessment, assess, reached_by
from vibrissa.forward.events import EventKind
from vibrissa.forward.locate import Indicator, Place, located, stepped
from vibrissa.forward.march import JUMP_FLOOR
from vibrissa.forward.path import Stretch, chosen
from vibrissa.forward.search import Settled
from vibrissa.forward.solve import tolerance_of
from vibrissa.numerics.kernel import Kernel
from vibrissa.numerics.linear import solve_pivoted

Happened: TypeAlias = tuple[EventKind, float, Float[np.ndarray, "3"]]
"""What happened, at which fraction of the stretch, and the contact point [L]."""

NO_FORCE = 1e-7
"""Force [EI/L²] up to which a contact counts as just begun or about to end."""


class LostError(Exception):
    """No equilibrium continues the state that was reached."""


@dataclass(frozen=True)
class End:
    """Why a way ended: arrived, released, snapped, or stuck."""

    reason: str
    at: Place


class Way(ABC):
    """A way of following an equilibrium along a stretch."""

    def __init__(self, scene: Scene, law: Law, stretch: Stretch) -> None:
        self._scene, self._law, self._stretch = scene, law, stretch

    @abstractmethod
    def enter(self, reached: Reached) -> Place | None:
        """The state reached before the stretch, placed at its start."""

    @abstractmethod
    def met(self, meeting: Meeting) -> Place | None:
        """A first contact."""

    @abstractmethod
    def settled(self, found: Settled, fraction: float) -> Place | None:
        """A frictionless equilibrium at a fraction, at rest."""

    @abstractmethod
    def track(self, start: Place, happened: list[Happened]) -> End:
        """Follow the equilibrium to the end of the stretch, to its release, or to where no
        neighbouring state is left; changes are noted as they happen.
        """

    def leaving(self, end: Place) -> State:
        """Frictionless states (k, …) that a rod passes when it leaves the end of a way, from there
        on.
        """
        state = end.reached.state
        return State(state.point[None], state.force[None], np.zeros((1, 0)), state.own[None])

    def energy(self, at: Place) -> float:
        """Potential [EI/L]."""
        return float(self._assessed(at.reached.state, at.fraction).potential)

    def _assessed(self, state: State, fraction: float) -> Assessment:
        clamp = self._stretch.clamps(np.array([fraction]))
        one = jax.tree.map(lambda part: np.asarray(part)[None], (state, clamp))
        values: Assessment = chosen(assess(self._scene, *one, self._law), 0)
        return values


_CONVERGED, _SOUND, _NO_STEP = 1e-12, 1e-9, 1e-15
"""Residual that ends the iterations; the same up to which a place counts as found, as rounding
leaves 2e-10 on thin tips; and the size of a step that ends them too.
"""
_ASTRAY = 1e-5
"""Longest (weighted) step taken once the conditions are met: a longer one comes from a singular
Jacobian.
"""
_MOST_ITERATIONS = 12
_FIRST_STEP, _LONGEST_STEP, _SHORTEST_STEP = 0.01, 0.03, 1e-10
"""Steps [L] along the branch, and with friction the longest way of a contact in one step; the
shortest is what rounding leaves at a fold.
"""
_MOST_STEPS = 600
_BIFURCATION_STEP = 2e-5
"""[L] down to which a step across a change of the determinant's sign is refined."""
_OPPOSITES = (
    {EventKind.TIP_TO_TANGENTIAL, EventKind.TANGENTIAL_TO_TIP},
    {EventKind.LATERAL_INSTABILITY, EventKind.LATERAL_RECOVERY},
)
_CHANGES = set[EventKind]().union(*_OPPOSITES)
"""Of a contact that goes on."""
_LEAPS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""How far [L] along the tangent at the end of a branch an equilibrium is searched for."""
_LOOKS_AHEAD, _NEAR = (1e-6, 1e-5, 1e-4, 1e-3), 1e-4
"""Fractions of the stretch past the end of a branch at which to look for an equilibrium, and how
near [L] it must be to continue the branch: a rod that jumps by less does not snap, and changes
that are no farther apart are at one place.
"""
_FORCE_WEIGHT, _LARGE_FORCE = 0.1, 5.0
"""Make force [EI/L²] and fraction of the stretch comparable with the contact point's path."""


class _Corrected(NamedTuple):
    """Newton's method on a plane across the branch: y = (p, f, the rod's own unknowns, fraction),
    the next step, the largest residual before it, and phase difference, arc length, tangent and
    Jacobian there.
    """

    y: Float[Array, "unknowns+1"]
    step: Float[Array, "unknowns+1"]
    miss: Float[Array, ""]
    iteration: Array
    phase: Float[Array, ""]
    arc_length: Float[Array, ""]
    tangent: Float[Array, "3"]
    jacobian: Float[Array, "unknowns unknowns+1"]


def _correct(
    scene: Scene, stretch: Stretch, guess: Any, normal: Any, weights: Any, reached: Any, most: Any
) -> _Corrected:
    """At most `most` steps from the guess, on the plane through it with the given normal, in
    weighted coordinates; 0 only evaluates the guess. `reached` is r of the previous state.
    """

    def conditions(y: Float[Array, "..."]) -> tuple[Any, Any]:
        clamp, state = stretch.clamp(y[-1]), State.of(y[:-1], scene.rod.unknowns)
        found = touching(scene, FRICTIONLESS, state, clamp, side=reached)
        told = found.phase, found.bent.arc_length, found.tangent
        return found.residual, told

    def unfinished(at: _Corrected) -> Array:
        moves = (at.miss >= _CONVERGED) & (jnp.max(jnp.abs(at.step * weights)) >= _NO_STEP)
        return (at.iteration == 0) | ((at.iteration <= most) & moves & jnp.isfinite(at.miss))

    def refine(at: _Corrected) -> _Corrected:
        y = at.y - at.step
        jacobian, (residual, told) = scene.rod.derivatives(conditions, y)
        right = jnp.append(residual, jnp.dot(normal, (y - guess) * weights))
        step, _ = solve_pivoted(jnp.concatenate([jacobian / weights, normal[None]]), right)
        step = step / weights
        phase, arc_length, tangent = told
        miss, done = jnp.max(jnp.abs(right)), at.iteration + 1
        return _Corrected(y, step, miss, done, phase, arc_length, tangent, jacobian)

    zero, blank = jnp.zeros(()), jnp.zeros((len(guess) - 1, len(guess)))
    start = _Corrected(
        guess, jnp.zeros(len(guess)), zero, jnp.zeros((), int), zero, zero, jnp.zeros(3), blank
    )
    end = lax.while_loop(unfinished, refine, start)
    size = jnp.max(jnp.abs(end.step * weights))
    # The last step is taken too, unless the conditions leave the point free and it leads astray.
    last = jnp.where((most > 0) & (size < _ASTRAY), end.step, 0.0)
    found: _Corrected = end._replace(y=end.y - last)
    return found


_corrected = Kernel(_correct, alone=True)


class Branch(Way):
    """Pseudo-arclength continuation."""

    def __init__(self, scene: Scene, law: Law, stretch: Stretch) -> None:
        super().__init__(scene, law, stretch)
        self._weighted(0.0)

    def _weighted(self, force: float) -> None:
        of_force = _FORCE_WEIGHT / max(1.0, force / _LARGE_FORCE)
        loads = [of_force] * (1 + self._scene.rod.unknowns)
        self._weights = np.array([1.0, 1.0, 1.0, *loads, max(self._stretch.motion, 1e-6)])
        self._to_fraction = np.append(np.zeros(3 + len(loads)), 1.0)

    def enter(self, reached: Reached) -> Place | None:
        """As in `Way`."""
        self._weighted(float(reached.state.force))
        return self._at(_flat(reached.state, 0.0))

    def met(self, meeting: Meeting) -> Place | None:
        """As in `Way`."""
        return self._at(np.array([*meeting.point, 0.0, *meeting.own, meeting.fraction]))

    def settled(self, found: Settled, fraction: float) -> Place | None:
        """As in `Way`."""
        return self._at(_flat(found.state, fraction))

    def leaving(self, end: Place) -> State:
        """As in `Way`: behind a fold the potential falls as the branch goes on."""
        y = _of(end) + np.outer([0.0, *_LEAPS], end.onward / self._weights)
        return State(y[:, :3], y[:, 3], np.zeros((len(y), 0)), y[:, 4:-1])

    def _at(self, y: Float[np.ndarray, "..."]) -> Place | None:
        """Place at y as given, its tangent pointing forward on the stretch."""
        return self._place(self._solved(y, self._to_fraction, y, 0), None)

    def _solved(
        self, guess: Any, normal: Any, origin: Any, most: int = _MOST_ITERATIONS
    ) -> _Corrected:
        """As `_correct`; where nothing else fixes the bending plane, it stays that of `origin`."""
        reached = origin[:3] - self._stretch.at(origin[-1:]).point
        found = _corrected(
            self._scene, self._stretch, guess, normal, self._weights, reached, np.asarray(most)
        )
        result: _Corrected = jax.tree.map(np.asarray, found)
        return result

    def _place(self, found: _Corrected, before: Place | None) -> Place | None:
        if not np.all(np.isfinite(found.jacobian)):
            return None
        tangent = np.linalg.svd(found.jacobian / self._weights)[2][-1]
        figure = float(signed(np.linalg.det(found.jacobian[:, :-1]), np))
        if before is None:
            onward = tangent[-1]
        elif figure * before.figure > 0:
            # At a corner it may turn by more than a right angle; while the determinant keeps its
            # sign it goes the same way along the stretch.
            onward = tangent[-1] * before.onward[-1]
        else:
            onward = tangent @ before.onward
        y = found.y
        state = State(y[:3], y[3], y[:0], y[4:-1])
        return Place(
            float(y[-1]),
            Reached(state, found.arc_length, found.tangent),
            figure,
            float(found.phase),
            tangent if onward > 0 else -tangent,
        )

    def _on_plane(self, guess: Any, normal: Any, origin: Any) -> _Corrected | None:
        """Solution on a plane, None without convergence."""
        found = self._solved(guess, normal, origin)
        return found if np.isfinite(found.y).all() and found.miss < _SOUND else None

    def _at_fraction(
        self, guess: Any, fraction: float, before: Place | None = None
    ) -> Place | None:
        """Equilibrium at a given fraction of the stretch."""
        found = self._on_plane(np.append(guess[:-1], fraction), self._to_fraction, guess)
        return None if found is None else self._place(found, before)

    def _along(self, start: Place, step: float) -> Place | None:
        """Place one step of arc length further on."""
        y = _of(start)
        found = self._on_plane(y + step * start.onward / self._weights, start.onward, y)
        if found is None or np.abs((found.y - y) * self._weights).max() > 3 * step:
            return None
        return self._place(found, start)

    def _length(self, start: Place, end: Place) -> float:
        """The step of `_along` that leads from one place of the branch to another."""
        return float(start.onward @ ((_of(end) - _of(start)) * self._weights))

    def _ahead_of_a_fold(
        self, here: Place, following: Place | None
    ) -> tuple[Place | None, Place | None]:
        """The next place, and the fold behind it if there is one: then it is the last place whose
        determinant tells of anything else, or the fold itself if that is past the stretch.
        """
        if following is None or following.onward[-1] > 0:
            return following, None
        fold = self._root(here, following, lambda place: place.onward[-1])
        if fold is None or fold.fraction >= 1:
            return fold, fold
        length = self._length(here, fold) - _BIFURCATION_STEP
        return (self._along(here, length) if length > 0 else here), fold

    def _root(self, start: Place, end: Place, figure: Callable[[Place], float]) -> Place | None:
        """Place between two where a figure is zero; None where the branch is lost on the way."""
        step = self._length(start, end)

        def at(length: float) -> Place:
            place = {0.0: start, step: end}.get(length) or self._along(start, length)
            if place is None:
                raise LostError
            return place

        if figure(start) * figure(end) >= 0:
            # No root between them, to rounding: take the end nearer to zero.
            return min(start, end, key=lambda place: abs(figure(place)))
        try:
            return at(
                scipy.optimize.brentq(
                    lambda length: figure(at(length)), 0.0, step, xtol=self._scene.rod.last_step
                )
            )
        except LostError:
            return None

    def track(self, start: Place, happened: list[Happened]) -> End:
        """As in `Way`."""
        here, step = start, _FIRST_STEP
        for _ in range(_MOST_STEPS):
            if step < _SHORTEST_STEP:
                beyond = self._beyond(here, here, happened)
                if beyond is None:
                    return self._snapped(here, happened)
                here, step = beyond, _FIRST_STEP
            following, fold = self._ahead_of_a_fold(here, self._along(here, step))
            if following is not None and following.fraction >= 1:
                following = self._arrival(here, following)
            if following is not None and following.reached.state.force < 0:
                release = self._release(here, following)
                if release is not None:
                    self._note(happened, self._changes(here, release))
                    return End("released", release)
                following = None
            if following is None:
                step /= 2
                continue
            if following.figure * here.figure < 0 and step > _BIFURCATION_STEP:
                # A bifurcation stays where it is when the step is refined; a branch that only comes
                # near another one is then followed past it.
                step = max(step / 4, 0.5 * _BIFURCATION_STEP)
                continue
            changes = self._changes(here, following)
            if changes is None:
                step /= 2
                continue
            self._note(happened, changes)
            here = following
            if here.fraction >= 1:
                return End("arrived", here)
            if fold is not None:
                beyond = self._beyond(here, fold, happened)
                if beyond is None:
                    return self._snapped(fold, happened)
                here = beyond
            step = min(1.5 * step, _LONGEST_STEP)
        return End("stuck", here)

    def _snapped(self, at: Place, happened: list[Happened]) -> End:
        """Where a branch ends its determinant, and at a corner its phase, may have changed already:
        with nothing behind, that is no event before the end.
        """
        change = EventKind.SNAP, at.fraction, at.reached.state.point
        happened[:] = [
            one for one in happened if one[0] not in _CHANGES or self._apart(one, change)
        ]
        return End("snapped", at)

    def _note(self, happened: list[Happened], changes: list[Happened] | None) -> None:
        """Add changes, except that a change and its opposite at one place are none."""
        for change in changes or []:
            undone = [
                row
                for row, one in enumerate(happened)
                if {one[0], change[0]} in _OPPOSITES and not self._apart(one, change)
            ]
            if undone:
                del happened[undone[-1]]
            else:
                happened.append(change)

    def _apart(self, one: Happened, other: Happened) -> bool:
        """Whether two events are not at the same place."""
        _, fraction, point = one
        _, its_fraction, its_point = other
        away = np.append(point - its_point, fraction - its_fraction) * self._weights[[0, 1, 2, -1]]
        return bool(np.abs(away).max() > _NEAR)

    def _release(self, here: Place, following: Place) -> Place | None:
        """Where the force falls to zero; None if it pulls on another branch."""

        def force(place: Place) -> float:
            return float(place.reached.state.force)

        release = self._root(here, following, force) if force(here) > 0 else here
        return release if release is not None and abs(force(release)) <= NO_FORCE else None

    def _arrival(self, here: Place, following: Place) -> Place | None:
        """The place at the end of the stretch, between two others."""
        # On a cubic: right at a bifurcation, where the Jacobian is singular, no step improves it.
        y, length = _of(here), self._length(here, following)
        way = _of(following) - y
        begin, end = (length * at.onward / self._weights - way for at in (here, following))

        def between(share: float) -> Float[np.ndarray, "..."]:
            rest = 1 - share
            return np.asarray(y + share * way + share * rest * (rest * begin - share * end))

        share = scipy.optimize.brentq(lambda share: between(share)[-1] - 1, 0.0, 1.0)
        return self._at_fraction(between(share), 1.0, here)

    def _beyond(self, here: Place, end: Place, happened: list[Happened]) -> Place | None:
        """Past a corner of the branch, where the phases meet or the object's curvature jumps, or a
        fold of less than a snap: the nearby equilibrium a little further on, if there is one.
        What changes up to there, after `here`, does so at the end.
        """
        y = _of(end)
        for ahead in _LOOKS_AHEAD:
            there = self._at_fraction(y, min(end.fraction + ahead, 1.0))
            if there is None or there.reached.state.force < 0:
                continue
            if np.abs((_of(there) - y) * self._weights).max() < _NEAR:
                self._note(happened, self._changes(here, there, corner=end))
                return there
        return None

    def _changes(
        self, here: Place, following: Place, corner: Place | None = None
    ) -> list[Happened] | None:
        """What changes between two places, or at a corner; None if it is not found where."""
        happened = list[Happened]()
        if (here.phase > 0) != (following.phase > 0):
            change = corner or self._root(here, following, lambda place: place.phase)
            if change is None:
                return None
            happened.append((_phase_change(following), change.fraction, change.reached.state.point))
        if here.figure * following.figure < 0:
            # The step is short here: the determinant is linear between its ends.
            share = here.figure / (here.figure - following.figure)
            y = _of(here) + share * (_of(following) - _of(here))
            lost = following.figure > 0
            kind = EventKind.LATERAL_INSTABILITY if lost else EventKind.LATERAL_RECOVERY
            happened.append((kind, float(y[-1]), y[:3]))
        return happened


def _phase_change(following: Place) -> EventKind:
    rises = following.phase > 0
    return EventKind.TIP_TO_TANGENTIAL if rises else EventKind.TANGENTIAL_TO_TIP


def _flat(state: State, fraction: float) -> Float[np.ndarray, "..."]:
    return np.array([*state.point, state.force, *state.own, fraction])


def _of(place: Place) -> Float[np.ndarray, "..."]:
    return _flat(place.reached.state, place.fraction)


_SHORTEST_RUB = 2.0**-20
"""Fraction of the stretch below which no step is tried, except the last to its end and half of it.
"""
_FASTEST = 20.0
"""How many times as fast as the clamp a contact may run: 9 times was seen where nothing snaps."""
_CLEARLY_INSIDE = -1e-6
"""Clearance [L] below which a contact cannot have been released."""
_ON_THE_CONE = 1 - 1e-9


def _row(parts: Any) -> Any:
    """Each array as the only row of a batch."""
    return jax.tree.map(lambda part: np.asarray(part, dtype=float)[None], parts)


class Rubbing(Way):
    """Forward steps with friction."""

    def enter(self, reached: Reached) -> Place | None:
        """As in `Way`; the figure stands in for that of a previous step: positive on the cone."""
        state = reached.state
        beyond = float(np.linalg.norm(state.lean) - self._scene.friction * _ON_THE_CONE)
        return Place(0.0, reached, beyond, float(self._assessed(state, 0.0).phase))

    def met(self, meeting: Meeting) -> Place | None:
        """As in `Way`."""
        state = State(meeting.point, np.zeros(()), np.zeros(self._law.unknowns), meeting.own)
        reached = Reached(state, meeting.arc_length, meeting.tangent)
        # Whether it sticks or slides is not known yet.
        return Place(float(meeting.fraction), reached, np.nan, np.nan)

    def settled(self, found: Settled, fraction: float) -> Place | None:
        """As in `Way`."""
        state = found.state._replace(lean=np.zeros(self._law.unknowns))
        values = self._assessed(state, fraction)
        reached = reached_by(values, state)
        return Place(fraction, reached, -float(self._scene.friction), float(values.phase))

    def track(self, start: Place, happened: list[Happened]) -> End:
        """As in `Way`."""
        motion, here, step = self._stretch.motion, start, (1 - start.fraction) / 2
        while here.fraction < 1:
            if step < min(_SHORTEST_RUB, (1 - here.fraction) / 2):
                return End("snapped", here)
            target = here.fraction + step
            way, start = _row((self._stretch, here))
            found = stepped(self._scene, self._law, way, start, np.array([[target]]))
            following, residual = chosen(found, (0, 0))
            moved = np.linalg.norm(following.reached.state.point - here.reached.state.point)
            far = moved > min((JUMP_FLOOR + _FASTEST * motion) * step, _LONGEST_STEP)
            if not residual <= tolerance_of(self._scene, self._law) or far:
                step /= 2
                continue
            if following.reached.state.force < 0:
                release = self._zero(here, following, Indicator.FORCE)
                clamps = self._stretch.clamps(np.array([[release.fraction]]))
                if clearances(self._scene, clamps).distance[0] < _CLEARLY_INSIDE:
                    step /= 2
                    continue
                return End("released", release)
            self._changes(here, following, happened)
            here, step = following, min(2 * step, 1.0 - target)
        return End("arrived", here)

    def _changes(self, here: Place, following: Place, happened: list[Happened]) -> None:
        slides = following.figure > 0
        cone = EventKind.STICK_TO_SLIP if slides else EventKind.SLIP_TO_STICK
        changes = (
            (here.phase, following.phase, Indicator.PHASE, _phase_change(following)),
            (here.figure, following.figure, Indicator.CONE, cone),
        )
        found = []
        for before, after, indicator, kind in changes:
            if np.isfinite(before) and (before > 0) != (after > 0):
                zero = self._zero(here, following, indicator)
                found.append((kind, float(zero.fraction), zero.reached.state.point))
        happened.extend(sorted(found, key=lambda happening: happening[1]))

    def _zero(self, here: Place, following: Place, indicator: Indicator) -> Place:
        """Where an indicator crosses zero between two places."""
        way, low, high = _row((self._stretch, here, following))
        found = located(self._scene, self._law, way, low, high, np.array([int(indicator)]))
        zero: Place = chosen(found, 0)
        return zero._replace(fraction=float(zero.fraction))
