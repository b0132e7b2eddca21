"""One stretch of one trail, resolved with care: where the march lost a lane.

The branch is followed by its arc length, so that it can be seen to turn back (fold). Steps are
halved where Newton's method does not converge.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int
from scipy.optimize import brentq

from vibrissa.contacts import Status
from vibrissa.forward.assess import ENERGY, assess_blocks
from vibrissa.forward.equations import Scene, contact_state, phase_difference
from vibrissa.forward.events import EventKind
from vibrissa.forward.landing import (
    AFTER_CONTACT,
    CLEAR,
    MOST_CHANGES,
    NO_FORCE,
    Outcome,
    clearance_at,
    failed,
    first_contact_on,
    settled_at_the_end,
    settled_on,
)
from vibrissa.forward.locate import ROUNDING, polished
from vibrissa.forward.march import Mode
from vibrissa.forward.path import clamp_between, pose_between
from vibrissa.forward.search import ENERGY_MARGIN
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.compiled import compiled
from vibrissa.numerics.linear import solve_pivoted

_CONVERGED = 1e-12
_NO_STEP = 1e-15
_SOUND = 1e-9
# Longest step (weighted) that is taken from where the conditions are met: a longer one comes of a
# singular Jacobian.
_ASTRAY = 1e-5
_ONWARD = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
_ITERATIONS = 12
_FIRST_STEP = 0.01
_LONGEST_STEP = 0.03
_SHORTEST_STEP = 1e-10
_MOST_STEPS = 600
_BIFURCATION_STEP = 2e-5
# Fractions of the stretch beyond the end of a branch, and how near an equilibrium there continues
# it.
_LOOKS_AHEAD = (1e-6, 1e-5)
_NEAR = 1e-3
# Fraction of the stretch by which a contact that ends has lasted.
_PROGRESS = 1e-9
# Weights that make force and fraction of the stretch commensurable with the contact point's path.
_FORCE_WEIGHT = 0.1
_LARGE_FORCE = 5.0

Point5 = Float[np.ndarray, "5"]


@dataclass(frozen=True)
class Branch:
    """A point (p, f, fraction) on a branch, with the Jacobian's determinant, the phase difference,
    and the tangent.
    """

    y: Point5
    tangent: Point5
    determinant: float
    phase: float


@dataclass(frozen=True)
class _End:
    """Why the tracker stopped: arrived, released, folded, or stuck."""

    reason: str
    at: Branch


class _Corrected(NamedTuple):
    """Newton's method on a plane across the branch, in numbers that NumPy unpacks: y, largest miss,
    phase difference and Jacobian (4, 5) there.
    """

    y: Array
    step: Array
    miss: Array
    iteration: Array
    phase: Array
    jacobian: Array


@compiled
def _corrected(
    scene: Scene,
    stretch: Float[AnyArray, "14"],
    guess: Float[AnyArray, "5"],
    normal: Float[AnyArray, "5"],
    weights: Float[AnyArray, "5"],
    reached: Float[AnyArray, "3"],
    most: int | Int[Array, ""],
) -> Float[Array, "27"]:
    """At most that many steps from the guess on the plane through it with the given normal, in
    weighted coordinates; none evaluates the guess.
    """
    stretch, guess, normal, weights, reached = (
        jnp.asarray(part) for part in (stretch, guess, normal, weights, reached)
    )

    def conditions(
        y: Float[Array, "5"],
    ) -> tuple[Float[Array, "4"], tuple[Float[Array, "4"], Float[Array, ""]]]:
        state = contact_state(scene, y[:4], clamp_between(stretch, y[4]), reached=reached)
        return state.residual, (state.residual, phase_difference(state.rod))

    def unfinished(at: _Corrected) -> Array:
        moves = (at.miss >= _CONVERGED) & (jnp.max(jnp.abs(at.step * weights)) >= _NO_STEP)
        return (at.iteration == 0) | ((at.iteration <= most) & moves & jnp.isfinite(at.miss))

    def refine(at: _Corrected) -> _Corrected:
        y = at.y - at.step
        jacobian, (residual, phase) = jax.jacfwd(conditions, has_aux=True)(y)
        right = jnp.append(residual, jnp.dot(normal, (y - guess) * weights))
        step = solve_pivoted(jnp.concatenate([jacobian / weights, normal[None]]), right) / weights
        return _Corrected(y, step, jnp.max(jnp.abs(right)), at.iteration + 1, phase, jacobian)

    zero = jnp.zeros(())
    start = _Corrected(guess, jnp.zeros(5), zero, jnp.zeros((), dtype=int), zero, jnp.zeros((4, 5)))
    end = lax.while_loop(unfinished, refine, start)
    last = jnp.where((most > 0) & (jnp.max(jnp.abs(end.step * weights)) < _ASTRAY), end.step, 0.0)
    sound = (end.miss < _CONVERGED) | (
        (end.miss < _SOUND) & (jnp.max(jnp.abs(end.step * weights)) < _NO_STEP)
    )
    # The last step is taken too, unless the conditions leave the point free and it leads astray.
    return jnp.concatenate(
        [
            end.y - last,
            jnp.where(sound, end.miss, jnp.inf)[None],
            end.phase[None],
            end.jacobian.ravel(),
        ]
    )


class Tracker:
    """Pseudo-arclength continuation on one stretch."""

    def __init__(self, scene: Scene, stretch: Float[np.ndarray, "14"], force: float = 0.0) -> None:
        self._scene, self._stretch = scene, stretch
        motion = float(
            np.linalg.norm(stretch[7:10] - stretch[:3])
            + 2 * np.linalg.norm(stretch[10:] - stretch[3:7])
        )
        self._weights = np.array(
            [1.0, 1.0, 1.0, _FORCE_WEIGHT / max(1.0, force / _LARGE_FORCE), max(motion, 1e-6)]
        )
        self._inverse_weights = 1 / self._weights

    def at(self, y: Point5, ahead: Point5 | None = None) -> Branch | None:
        """Branch point at y, its tangent towards `ahead` (default: forward on the stretch)."""
        return self._branch(self._solved(y, _ONWARD, y, 0), ahead)

    def _solved(
        self, guess: Point5, normal: Point5, origin: Point5, most: int = _ITERATIONS
    ) -> Float[np.ndarray, "27"]:
        """As `_corrected`; where nothing else fixes the bending plane, it stays that of `origin`."""
        reached = origin[:3] - pose_between(self._stretch, origin[4:])[0]
        return np.asarray(
            _corrected(self._scene, self._stretch, guess, normal, self._weights, reached, most)
        )

    def _branch(self, solved: Float[np.ndarray, "27"], ahead: Point5 | None) -> Branch | None:
        y, phase, jacobian = solved[:5], float(solved[6]), solved[7:].reshape(4, 5)
        if not np.all(np.isfinite(jacobian)):
            return None
        tangent = np.linalg.svd(jacobian * self._inverse_weights)[2][-1]
        onward = tangent[4] if ahead is None else tangent @ ahead
        return Branch(
            y, tangent if onward > 0 else -tangent, float(np.linalg.det(jacobian[:, :4])), phase
        )

    def _on_plane(
        self, guess: Point5, normal: Point5, origin: Point5
    ) -> Float[np.ndarray, "27"] | None:
        """Newton's method on the plane through the guess whose normal is given (weighted
        coordinates); None without convergence.
        """
        solved = self._solved(guess, normal, origin)
        return solved if np.isfinite(solved[:6]).all() else None

    def at_fraction(
        self, guess: Point5, fraction: float, ahead: Point5 | None = None
    ) -> Branch | None:
        """Equilibrium at a given fraction of the stretch."""
        solved = self._on_plane(np.append(guess[:4], fraction), _ONWARD, guess)
        return None if solved is None else self._branch(solved, ahead)

    def along(self, start: Branch, step: float) -> Branch | None:
        """Branch point one step of arc length on."""
        solved = self._on_plane(
            start.y + step * start.tangent * self._inverse_weights, start.tangent, start.y
        )
        if solved is None or np.abs((solved[:5] - start.y) * self._weights).max() > 3 * step:
            return None
        return self._branch(solved, start.tangent)

    def root(self, start: Branch, step: float, figure: Callable[[Branch], float]) -> Branch:
        """Branch point between `start` and one step on at which a figure of opposite signs there is
        zero.
        """

        def value(length: float) -> float:
            point = self.along(start, length) if length > 0 else start
            if point is None:
                raise _LostOnTheWayError
            return figure(point)

        try:
            length = brentq(value, 0.0, step, xtol=1e-15, rtol=1e-14)
        except (_LostOnTheWayError, ValueError):
            # No root between them, to rounding: the end that comes nearer to it.
            end = self.along(start, step)
            return start if end is None or abs(figure(start)) <= abs(figure(end)) else end
        point = self.along(start, length) if length > 0 else start
        return start if point is None else point

    def track(
        self, start: Branch, happened: list[tuple[EventKind, float, Float[np.ndarray, "3"]]]
    ) -> _End:
        """Follow the branch to the end of the stretch, its release, or its fold; phase changes and
        lateral instabilities are noted on the way.
        """
        here, step = start, _FIRST_STEP
        for _ in range(_MOST_STEPS):
            if step < _SHORTEST_STEP:
                beyond = self._beyond(here)
                if beyond is None:
                    return _End("folded", here)
                here, step = beyond, _FIRST_STEP
            following = self.along(here, step)
            if following is not None and following.tangent[4] <= 0:
                return _End("folded", self.root(here, step, lambda point: point.tangent[4]))
            if following is not None and following.y[4] >= 1:
                following = self._arrival(here, following)
                step = (
                    step
                    if following is None
                    else float(here.tangent @ ((following.y - here.y) * self._weights))
                )
            if following is not None and following.y[3] < 0:
                release = self.root(here, step, lambda point: point.y[3]) if here.y[3] > 0 else here
                if abs(release.y[3]) <= NO_FORCE:
                    self._changes(here, release, step, happened)
                    return _End("released", release)
                # Not a force that falls to zero, but another branch on which it pulls.
                following = None
            if following is None:
                step /= 2
                continue
            if following.determinant * here.determinant < 0 and step > _BIFURCATION_STEP:
                # A bifurcation keeps its place when the step is refined; a branch that only comes
                # near another one is followed round.
                step = max(step / 4, 0.5 * _BIFURCATION_STEP)
                continue
            self._changes(here, following, step, happened)
            here = following
            if here.y[4] >= 1:
                return _End("arrived", here)
            step = min(1.5 * step, _LONGEST_STEP)
        return _End("stuck", here)

    def _arrival(self, here: Branch, following: Branch) -> Branch | None:
        """The branch point at the end of the stretch, between two others."""
        between = here.y + (following.y - here.y) * (1 - here.y[4]) / (following.y[4] - here.y[4])
        return self.at_fraction(between, 1.0, here.tangent)

    def _beyond(self, here: Branch) -> Branch | None:
        """Past a corner of the branch, where the phases meet or the object's curvature jumps: the
        equilibrium near by and a little further on, if there is one.
        """
        for ahead in _LOOKS_AHEAD:
            there = self.at_fraction(here.y, min(here.y[4] + ahead, 1.0))
            if (
                there is not None
                and np.abs((there.y - here.y) * self._weights).max() < _NEAR
                and there.y[3] >= 0
            ):
                return there
        return None

    def _changes(
        self,
        here: Branch,
        following: Branch,
        step: float,
        happened: list[tuple[EventKind, float, Float[np.ndarray, "3"]]],
    ) -> None:
        if (here.phase > 0) != (following.phase > 0):
            change = self._polished(self.root(here, step, lambda point: point.phase))
            kind = (
                EventKind.TIP_TO_TANGENTIAL if following.phase > 0 else EventKind.TANGENTIAL_TO_TIP
            )
            happened.append((kind, float(change.y[4]), change.y[:3]))
        if here.determinant * following.determinant < 0:
            # The step is short here: between its ends the determinant is a straight line.
            share = here.determinant / (here.determinant - following.determinant)
            change = replace(here, y=here.y + share * (following.y - here.y))
            kind = (
                EventKind.LATERAL_INSTABILITY
                if following.determinant > 0
                else EventKind.LATERAL_RECOVERY
            )
            happened.append((kind, float(change.y[4]), change.y[:3]))

    def _polished(self, at: Branch) -> Branch:
        y, sound = polished(self._scene, self._stretch[None], at.y[None])
        inside = -ROUNDING < y[0, 4] < 1 + ROUNDING
        return replace(at, y=y[0]) if sound[0] and inside else at


class _LostOnTheWayError(Exception):
    pass


def follow(
    scene: Scene, stretch: Float[np.ndarray, "14"], mode: Mode, x: Float[np.ndarray, "4"]
) -> Outcome:
    """Resolve a stretch from mode FREE or CONTACT (with x) at its start; with mode LOST only its
    end is known.
    """
    tracker = Tracker(scene, stretch, float(x[3]) if mode == Mode.CONTACT else 0.0)
    outcome = Outcome(mode, x)
    fraction = 0.0
    here = tracker.at(np.append(x, 0.0)) if mode == Mode.CONTACT else None
    if mode == Mode.LOST or (mode == Mode.CONTACT and here is None):
        return _anew(scene, stretch, tracker, outcome, EventKind.STARTED_IN_CONTACT)
    for _ in range(MOST_CHANGES):
        if here is None:
            outcome.mode = Mode.FREE
            met = first_contact_on(scene, stretch, fraction, outcome)
            if met is None:
                return outcome
            here = tracker.at(np.array([*met.point, 0.0, met.fraction]))
            if here is None:
                return failed(outcome, Status.NOT_CONVERGED)
        since = float(here.y[4])
        end = tracker.track(here, outcome.happened)
        fraction = float(end.at.y[4])
        if end.reason == "arrived":
            return _arrived(outcome, end.at)
        if end.reason == "stuck":
            break
        try:
            here, fraction = _behind(scene, stretch, tracker, end, since, outcome)
        except _LostOnTheWayError:
            return _anew(scene, stretch, tracker, outcome)
    return _anew(scene, stretch, tracker, outcome, EventKind.STARTED_IN_CONTACT)


def _anew(
    scene: Scene,
    stretch: Float[np.ndarray, "14"],
    tracker: Tracker,
    outcome: Outcome,
    happening: EventKind | None = None,
) -> Outcome:
    """Take up the lane at the end of the stretch, whatever went before."""
    found = settled_at_the_end(scene, stretch, outcome)
    here = None if found is None else tracker.at(np.append(found.x, 1.0))
    if here is None:
        return outcome if found is None else failed(outcome, Status.NO_EQUILIBRIUM)
    if happening is not None:
        outcome.happened.append((happening, 1.0, here.y[:3]))
    return _arrived(outcome, here)


def _behind(
    scene: Scene,
    stretch: Float[np.ndarray, "14"],
    tracker: Tracker,
    end: _End,
    since: float,
    outcome: Outcome,
) -> tuple[Branch | None, float]:
    """Where the lane goes on behind the end of a branch begun at `since`, and from which fraction:
    on another branch, or free (None).
    """
    last, fraction = end.at.y, float(end.at.y[4])
    leaving = (
        last[3] <= NO_FORCE
        and clearance_at(scene, stretch, min(1.0, fraction + AFTER_CONTACT[0])) >= CLEAR
    )
    if leaving or (end.reason == "released" and fraction - since > _PROGRESS):
        outcome.happened.append((EventKind.DETACH, fraction, last[:3]))
        return None, fraction
    if last[3] <= NO_FORCE:
        # The straight rod met the object along a line or at an edge: the contact begins elsewhere
        # than where it was first seen.
        return _begun(scene, stretch, tracker, fraction, last[:3])
    outcome.happened.append((EventKind.SNAP, fraction, last[:3]))
    if clearance_at(scene, stretch, fraction) >= CLEAR:
        return None, fraction
    here = _settled(
        scene, stretch, tracker, fraction, _energy(scene, stretch, last) - ENERGY_MARGIN, [last[:3]]
    )
    if here is not None:
        return here, fraction
    if clearance_at(scene, stretch, 1.0) >= CLEAR:
        # What is left of the contact ends before the next position.
        return None, 1.0
    raise _LostOnTheWayError


def _settled(
    scene: Scene,
    stretch: Float[np.ndarray, "14"],
    tracker: Tracker,
    fraction: float,
    energy: float,
    near: list[Float[np.ndarray, "3"]],
) -> Branch | None:
    found = settled_on(scene, stretch, fraction, energy, near)
    return None if found is None else tracker.at(np.append(found.x, fraction))


def _energy(scene: Scene, stretch: Float[np.ndarray, "14"], y: Point5) -> float:
    pose = np.concatenate(pose_between(stretch, y[4:]))
    return float(scene.in_blocks(assess_blocks, y[None, :4], pose[None])[0, ENERGY])


def _begun(
    scene: Scene,
    stretch: Float[np.ndarray, "14"],
    tracker: Tracker,
    fraction: float,
    near: Float[np.ndarray, "3"],
) -> tuple[Branch, float]:
    """The equilibrium of least energy a little behind a first contact."""
    for ahead in AFTER_CONTACT:
        at = min(1.0, fraction + ahead)
        here = _settled(scene, stretch, tracker, at, np.inf, [near])
        if here is not None:
            return here, at
    raise _LostOnTheWayError


def _arrived(outcome: Outcome, at: Branch) -> Outcome:
    outcome.mode, outcome.x, outcome.figure, outcome.phase = (
        Mode.CONTACT,
        at.y[:4],
        at.determinant,
        at.phase,
    )
    return outcome
