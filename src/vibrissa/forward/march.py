"""Many trails in step: each position starts from an extrapolation of the previous ones, and is
solved by Newton's method.

The march handles what goes smoothly. Where a lane does not converge, jumps, changes the sign of its
Jacobian determinant, or has the free rod inside the object without a first contact, the march
marks that lane as lost; the sweep resolves the stretch, and the march resumes after it.
"""

from enum import IntEnum
from functools import partial
from itertools import accumulate
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int

from vibrissa.contact import Law, Reached, Scene, State
from vibrissa.forward.foretold import ORDERS, QUADRATIC, Differences, Slopes, best_of, with_value
from vibrissa.forward.path import chosen
from vibrissa.forward.solve import SHARP, solved, tolerance_of
from vibrissa.mechanics.model import Clamp
from vibrissa.numerics.bracket import POINTS
from vibrissa.numerics.lanes import WIDTH, Lanes, lanes
from vibrissa.numerics.rows import row_of, with_row
from vibrissa.numerics.vectors import joined

Scalar = Float[Any, ""]
Unknowns = Float[Array, "unknowns"]


class Mode(IntEnum):
    """What a lane does at a position."""

    FREE = 0
    CONTACT = 1
    LOST = 2
    WAITING = 3


class Legs(NamedTuple):
    """What the march needs of a lane; the first four of all its positions (n, …)."""

    clamp: Clamp
    clear: Bool[Any, "n"]
    """The free rod is outside the object."""
    met: Bool[Any, "n"]
    """The free rod makes first contact on the stretch that ends here."""
    meeting: Reached
    """State at that first contact."""
    start: Int[Any, ""]
    """Index at which the lane enters, with `mode` and `reached` given there."""
    mode: Int[Any, ""]
    reached: Reached
    sign: Scalar
    """Sign of the Jacobian's determinant: negative on a stable branch."""
    fanned: Bool[Any, ""]
    """Each position is one step from where the lane enters: trial places on one stretch, in search
    of an event.
    """
    guarded: Bool[Any, ""]
    """A contact that moves far, or elsewhere than expected, is lost."""
    tolerance: Scalar
    """Residual from which the next Newton step is the last."""


class Steps(NamedTuple):
    """What the march found at the positions of a lane (n, …)."""

    reached: Reached
    mode: Int[Any, "n"]
    figure: Float[Any, "n"]
    """Determinant of the Jacobian; with friction, how far outside the cone the force would lie
    without sliding.
    """
    phase: Float[Any, "n"]
    residual: Float[Any, "n"]


class _Carry(NamedTuple):
    last: Reached
    differences: Differences
    """Of point, force and the rod's own unknowns."""
    age: Int[Any, ""]
    """Positions since the contact began; differences of higher order are not known yet: zero."""
    mode: Int[Any, ""]
    slopes: Slopes | None
    """Where they are those of a rougher rod."""


JUMP, JUMP_FLOOR = 8.0, 0.02
"""A contact that moves farther [L] than this many times the clamp's motion, plus a floor, has
jumped: before a smooth change of phase it may move several times as fast as the clamp.
"""
_MISS, _MISS_FLOOR = {True: 0.4, False: 0.7}, 0.005
"""The same for how far it is from where it was expected, as a fraction of its own motion: less on
a branch, where a closer look costs little, than with friction.
"""
_REVERSED = 0.05
"""And for the force, besides that fraction of its change, as a fraction of itself: past a fold it
is another one, even where the contact is nearly in its place.
"""
STABLE = -1.0
"""Sign of the Jacobian's determinant on a stable branch."""
_FAN, _ROOM = 1 + POINTS, 256
"""Positions of lanes that only locate an event, and of a trail that are walked in one call: code is
compiled once for trails of any length.
"""
_BACK = 3
"""Positions behind a lane that it looks back at."""
SINGLE = 8
"""Up to this many lanes are walked one after another; more are quicker side by side."""


def nowhere(scene: Scene, law: Law, *shape: int, fill: float = np.nan) -> Reached:
    """Stands for what is reached where there is no contact."""

    def full(*width: int) -> Float[np.ndarray, "..."]:
        return np.full((*shape, *width), fill)

    state = State(full(3), full(), full(law.unknowns), full(scene.rod.unknowns))
    return Reached(state, full(), full(3))


def entering(scene: Scene, law: Law, clamps: Clamp) -> Legs:
    """Legs of lanes at clamps (k, n, 3) that enter in contact at the first one; what they have
    reached there is still to be filled in.
    """
    count, n = clamps.point.shape[:2]
    never, first = np.zeros((count, n), dtype=bool), np.zeros(count, dtype=int)
    shapes = (count,), (count, n)
    reached, meeting = (nowhere(scene, law, *shape, fill=0.0) for shape in shapes)
    modes, signs = np.full(count, int(Mode.CONTACT)), np.full(count, STABLE)
    fanned, guarded = first > 0, first == 0
    tolerance = np.full(count, tolerance_of(scene, law))
    given = first, modes, reached, signs, fanned, guarded, tolerance
    return Legs(clamps, never, never.copy(), meeting, *given)


def march(scene: Scene, law: Law, legs: Legs) -> Steps:
    """Walk k lanes through all of their n positions: legs and steps (k, n, …), in model units."""
    count, n = legs.clear.shape
    walk, room = _kernel(count, n)
    carry, at = _before(scene, law, legs), int(legs.start.min(initial=n))
    parts = [_waiting(scene, law, count, at)] if at else []
    while at < n:
        first = max(0, at - _BACK)
        end = min(first + room, n)
        shared = scene, law, np.asarray(at - first), np.asarray(end - first)
        steps, carry = walk(shared, _window(legs, first, end, room), carry)
        parts.append(chosen(steps, np.s_[:, at - first : end - first]))
        at = end
    if len(parts) == 1:  # as for most trails: nothing to copy
        return parts[0]
    return jax.tree.map(lambda *rows: np.concatenate(rows, axis=1), *parts)


def _waiting(scene: Scene, law: Law, *shape: int) -> Steps:
    nothing = np.full(shape, np.nan)
    mode = np.full(shape, int(Mode.WAITING))
    return Steps(nowhere(scene, law, *shape), mode, nothing, nothing, nothing)


def march_ahead(scene: Scene, law: Law, clamps: Clamp) -> None:
    """Compile in the background what the march through clamps (k, n, 3) needs."""
    legs = entering(scene, law, clamps)
    count, n = legs.clear.shape
    walk, room = _kernel(count, n)
    shared = scene, law, np.asarray(0), np.asarray(0)
    walk.ahead(shared, _window(legs, 0, min(n, room), room), _before(scene, law, legs))


def _kernel(count: int, n: int) -> tuple[Lanes[Any, Any], int]:
    """What walks such lanes, and how many positions in one call: up to a block of short lanes share
    the code for a trail.
    """
    return (_fans, _FAN) if n <= _FAN and count > WIDTH else (_trails, _ROOM)


def _window(legs: Legs, first: int, end: int, room: int) -> Legs:
    """Legs with the positions from `first` to `end`, padded to a number; a start before them is
    negative.
    """

    def padded(rows: np.ndarray) -> np.ndarray:
        whole = np.zeros((len(rows), room, *rows.shape[2:]), rows.dtype)
        whole[:, : end - first] = rows[:, first:end]
        return whole

    clamp, clear, met, meeting = jax.tree.map(padded, legs[:4])
    return legs._replace(
        clamp=clamp, clear=clear, met=met, meeting=meeting, start=legs.start - first
    )


def from_seeds(
    scene: Scene, law: Law, clamp: Clamp, seeds: State, tolerance: float = SHARP
) -> Steps:
    """Newton's method from states (k, …) at one clamp pose, to steps (k, …) in the same order: each
    is a first contact on a lane that then goes on as if it had not happened. The step from a
    residual within the tolerance is the last.
    """
    count, room = len(seeds.force), _ROOM - 1
    rows = -(-count // room)
    lane, position = np.indices((rows, _ROOM))
    which = lane * room + position - 1
    given = (position > 0) & (which < count)
    which = np.clip(which, 0, count - 1)
    clamps = jax.tree.map(lambda part: np.broadcast_to(part, (*which.shape, 3)), clamp)
    legs = entering(scene, law, clamps)
    legs = legs._replace(
        met=given,
        meeting=legs.meeting._replace(state=chosen(seeds, which)),
        mode=np.full(rows, int(Mode.FREE)),
        fanned=np.ones(rows, dtype=bool),
        tolerance=np.full(rows, tolerance),
    )
    parts = [
        march(scene, law, chosen(legs, np.s_[first : first + SINGLE]))
        for first in range(0, rows, SINGLE)
    ]
    found: Steps = jax.tree.map(
        lambda *parts: np.concatenate([row[1:] for part in parts for row in part])[:count], *parts
    )
    return found


def _before(scene: Scene, law: Law, legs: Legs) -> _Carry:
    """What lanes (k, …) carry before they enter."""
    count, unknowns = len(legs.start), 4 + scene.rod.unknowns
    none, age = np.zeros((count, unknowns)), np.zeros(count, dtype=int)
    slopes = Slopes.none(unknowns) if law.branch and scene.rod.rough is not None else None
    slopes = jax.tree.map(lambda part: np.tile(part, (count, *(1,) * part.ndim)), slopes)
    waiting = np.full(count, int(Mode.WAITING))
    return _Carry(legs.reached, [none] * ORDERS, age, waiting, slopes)


def _walk(
    shared: tuple[Scene, Law, Int[Array, ""], Int[Array, ""]], legs: Legs, carry: _Carry
) -> tuple[Steps, _Carry]:
    """Walk a lane through its positions from `first` to `end`; these, scene and law are shared."""
    scene, law, first, end = shared
    size = legs.clear.shape[0]
    steps: Steps = jax.tree.map(
        lambda part: jnp.full((size, *part.shape), jnp.nan),
        Steps(legs.reached, *(legs.sign,) * 4),
    )
    steps = steps._replace(mode=jnp.full(size, int(Mode.WAITING)))
    # Looked at by lanes that are fanned out; these enter in the same call.
    begin = row_of(legs.clamp, jnp.maximum(legs.start, 0))

    def advance(index: Array, state: tuple[Steps, _Carry]) -> tuple[Steps, _Carry]:
        steps, carry = state
        carry, row = _advance(scene, law, legs, begin, index, carry)
        return with_row(steps, row, index), carry

    walked: tuple[Steps, _Carry] = lax.fori_loop(first, end, advance, (steps, carry))
    return walked


_trails = lanes(blocks=1, alone=SINGLE, walks=True)(_walk)
_fans = lanes(walks=True)(_walk)


def _advance(
    scene: Scene, law: Law, legs: Legs, begin: Clamp, index: Array, carry: _Carry
) -> tuple[_Carry, Steps]:
    clamp, clear, met, meeting = row_of(legs[:4], index)
    free, touches = carry.mode == Mode.FREE, carry.mode == Mode.CONTACT
    entering = free & met
    active = touches | entering
    last = carry.last
    foretold = list(accumulate(carry.differences))
    expected = best_of(carry.differences, carry.age) if law.branch else foretold[QUADRATIC]
    # The tangential force starts from its last value, as sliding may stop or turn.
    guess = State(expected[:3], expected[3], last.state.lean, expected[4:])
    guess = jax.tree.map(lambda met, other: jnp.where(entering, met, other), meeting.state, guess)
    before = jax.tree.map(lambda met, other: jnp.where(entering, met, other), meeting, last)
    come_from = [
        jax.tree.map(
            partial(jnp.where, legs.fanned), begin, row_of(legs.clamp, jnp.maximum(index - k, 0))
        )
        for k in range(1, _BACK + 1)
    ]
    side = before.state.point - come_from[0].point
    guess = law.begun(scene, guess, before, come_from[0], clamp)
    known = carry.slopes and carry.slopes.at(jnp.where(touches, carry.age + 1, 1))
    found = solved(scene, law, guess, clamp, before, side, active, legs.tolerance, known)

    converged = found.residual <= tolerance_of(scene, law)
    state = found.reached.state
    moved = _length(state.point - last.state.point)
    missed = jnp.min(joined(*(_length(state.point - order[:3]) for order in foretold[:-1])))
    miss = _MISS[law.branch]
    tolerated = _MISS_FLOOR + miss * moved
    if not law.branch:
        # With friction the contact changes direction at a corner of the trail, without a jump.
        tolerated += JUMP * _clamp_miss(clamp, come_from, carry.age)
    now, then = state.force, last.state.force
    unlike = jnp.min(joined(*(jnp.abs(now - order[3]) for order in foretold[:-1])))
    other = unlike > miss * jnp.abs(now - then) + _REVERSED * jnp.maximum(now, then)
    reverses = jnp.asarray(law.branch) & other
    misses = (carry.age >= 1) & ((missed > tolerated) | reverses)
    motion = _length(joined(*(b - a for a, b in zip(come_from[0], clamp, strict=True))))
    jumps = moved > JUMP_FLOOR + JUMP * motion
    leaps = legs.guarded & touches & (jumps | misses)
    # A contact that pulls has been lost; the solution past that point tells by how much.
    released = touches & converged & ~leaps & (state.force < 0)
    held = active & converged & ~leaps & (state.force >= 0)
    if law.branch:
        held &= found.figure * legs.sign > 0
    mode = jnp.where(held, Mode.CONTACT, Mode.LOST)
    mode = jnp.where((free & ~entering & clear) | (released & clear), Mode.FREE, mode)
    given = index == legs.start
    mode = jnp.where(given, legs.mode, mode)
    mode = jnp.where((carry.mode == Mode.WAITING) & ~given, Mode.WAITING, mode)
    mode = jnp.where(carry.mode == Mode.LOST, Mode.LOST, mode)
    reached = jax.tree.map(
        lambda known, new: jnp.where(given, known, new), legs.reached, found.reached
    )

    fresh = entering | given
    age = jnp.where(fresh, 0, carry.age + 1)
    here = joined(reached.state.point, reached.state.force, reached.state.own)
    differences = with_value(carry.differences, here, age)
    slopes = carry.slopes and carry.slopes.after(age, found)
    following = _Carry(reached, differences, age, mode, slopes)
    following = jax.tree.map(
        lambda kept, new: jnp.where(legs.fanned & ~given, kept, new), carry, following
    )
    return following, Steps(reached, mode, found.figure, found.phase, found.residual)


def _length(vector: Float[Array, "n"]) -> Scalar:
    return jnp.sqrt(jnp.sum(vector**2))


def _next(last: Array, before: Array, second_before: Array, age: Array) -> Array:
    """Extrapolation from the last three values, or from as many as a new contact has."""
    linear = 2 * last - before
    quadratic = 3 * (last - before) + second_before
    return jnp.where(age >= 2, quadratic, jnp.where(age >= 1, linear, last))


def _clamp_miss(clamp: Clamp, back: list[Clamp], age: Array) -> Scalar:
    """How far the clamp is from where the same rule would have put it."""
    misses = [
        here - _next(last, before, second_before, age)
        for here, last, before, second_before in zip(clamp, *back, strict=True)
    ]
    return _length(joined(*misses))
