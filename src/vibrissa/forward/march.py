"""Many trails in step: each position starts from an extrapolation of the previous ones, and is
solved by Newton's method.

The march handles what goes smoothly. Where a lane does not converge, jumps, changes the sign of its
Jacobian determinant, or has the free rod inside the object without a first contact, the march
marks that lane as lost; the sweep resolves the stretch, and the march resumes after it.
"""

from collections.abc import Callable
from enum import IntEnum
from functools import partial
from itertools import accumulate
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int

from vibrissa.contact import Law, Reached, Scene, State, Touching, step_from, touching
from vibrissa.forward.path import chosen
from vibrissa.mechanics.model import Clamp, RodModel
from vibrissa.numerics.bracket import POINTS
from vibrissa.numerics.derivatives import CHANGE, exact
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
    differences: list[Float[Any, "expected"]]
    """Backward differences of point, force and the rod's own unknowns; those of order 0 are the
    values themselves.
    """
    age: Array
    """Positions since the contact began; differences of higher order are not known yet: zero."""
    mode: Array


_ORDERS = 8
"""Differences kept: trails with steps of 0.01 L then need about one Newton step per position."""
_UNTESTED = 2
"""Order to which a contact is extrapolated without checking how well that did before."""
_BETTER = 2.0
"""Factor by which a higher order has to do better: after a kink all orders do equally badly, and
the highest overshoots most.
"""
_NEARBY, _KEPT = 1e-5, 0.05
"""Residual from which on slopes serve for the next Newton step too, as long as one reduces the
residual to that fraction: new ones gain three digits, but cost more than the step itself.
"""
RUBBING = 1e-11
"""Largest residual from which the next Newton step, converging quadratically, is the last with
friction, where errors in what is passed on, computed before that step, add up; on a branch it is
the rod's own.
"""
SHARP = 1e-13
"""The same for an event, whose figure is computed before the last step: what rounding leaves."""
JUMP, JUMP_FLOOR = 8.0, 0.02
"""A contact that moves farther [L] than this many times the clamp's motion, plus a floor, has
jumped: before a smooth change of phase it may move several times as fast as the clamp.
"""
_MISS, _MISS_FLOOR = 0.7, 0.005
"""The same for how far it is from where it was expected, as a fraction of its own motion."""
_REVERSED = 0.05
"""And for the force, besides that fraction of its change, as a fraction of itself: past a fold it
is another one, even where the contact is nearly in its place.
"""
MOST_ITERATIONS = {True: 12, False: 25}
"""On a branch, where a poor guess is better left to `follow`; and with friction, whose conditions
have corners.
"""


STABLE = -1.0
"""Sign of the Jacobian's determinant on a stable branch."""
_FAN, _SHORTEST_TRAIL = 1 + POINTS, 256
"""Positions of lanes that only locate an event, and room for those of a trail."""
SINGLE = 8
"""Up to this many lanes are walked one after another; more are quicker side by side."""


def tolerance_of(scene: Scene, law: Law) -> float:
    """Largest residual from which the next Newton step is the last."""
    return scene.rod.last_step if law.branch else RUBBING


class Solved(NamedTuple):
    """Result of Newton's method."""

    reached: Reached
    residual: Scalar
    figure: Scalar
    phase: Scalar


def solved(
    scene: Scene,
    law: Law,
    guess: State,
    clamp: Clamp,
    before: Reached | None,
    side: Float[Any, "3"] | None,
    active: Bool[Any, ""],
    tolerance: Scalar,
) -> Solved:
    """Newton's method for one position, given the previous one, if the lane is active; the step
    from a residual within the tolerance is the last.
    """

    def conditions(x: Unknowns, rod: RodModel, near: Scalar | None) -> tuple[Unknowns, Touching]:
        own = scene._replace(rod=rod)
        found = touching(own, law, State.of(x, rod.unknowns), clamp, before, side, near)
        return found.residual, found

    found = newton(scene.rod, law, conditions, guess.flat, tolerance, active=active)
    reached = Reached(State.of(found.x, scene.rod.unknowns), found.arc_length, found.tangent)
    figure = found.determinant if law.branch else found.beyond
    return Solved(reached, found.residual, figure, found.phase)


class Found(NamedTuple):
    """Where Newton's method ended; everything but `x` is from before its last step."""

    x: Unknowns
    residual: Scalar
    jacobian: Float[Array, "unknowns unknowns"]
    determinant: Scalar
    arc_length: Scalar
    tangent: Float[Array, "3"]
    phase: Scalar
    beyond: Scalar


def newton(
    rod: RodModel,
    law: Law,
    conditions: Callable[[Unknowns, RodModel, Scalar | None], tuple[Unknowns, Touching]],
    guess: Unknowns,
    tolerance: Scalar | float,
    *,
    active: Bool[Any, ""] | bool = True,
) -> Found:
    """Newton's method for conditions on a rod, or on the one that gives slopes, near an arc length
    if that is known; the step from a residual within the tolerance is the last.
    """

    def iterate(state: tuple[Found, Array]) -> tuple[Found, Array]:
        return _once(rod, law, conditions, state[0]), state[1] + 1

    def unfinished(state: tuple[Found, Array]) -> Array:
        return active & (state[0].residual > tolerance) & (state[1] < MOST_ITERATIONS[law.branch])

    nan = jnp.full((), jnp.nan)
    blank = jnp.full((len(guess),) * 2, jnp.nan)
    start = Found(guess, jnp.full((), jnp.inf), blank, nan, nan, jnp.full(3, jnp.nan), nan, nan)
    found: tuple[Found, Array] = lax.while_loop(
        unfinished, iterate, (start, jnp.zeros((), dtype=int))
    )
    return found[0]


def _once(
    rod: RodModel,
    law: Law,
    conditions: Callable[[Unknowns, RodModel, Scalar | None], tuple[Unknowns, Touching]],
    last: Found,
) -> Found:
    """One Newton step from where the last one led."""
    rough = rod.rough

    def values(
        x: Unknowns, rod: RodModel = rod, near: Scalar | None = None
    ) -> tuple[Unknowns, tuple[Any, ...]]:
        residual, found = conditions(x, rod, near)
        return residual, (found.bent.arc_length, found.tangent, found.phase, found.beyond)

    def derivatives(_: Any, x: Unknowns) -> tuple[Array, tuple[Unknowns, Any]]:
        if rough is None:
            return rod.derivatives(values, x)
        if not law.branch:
            # Friction has corners, and at some of them contacts begin.
            return exact(lambda x: (values(x, rough)[0], ()), x)[0], values(x)
        return _roughly(rod, rough, values, last, x)

    step, told = step_from(values, last.x, derivatives=derivatives)
    return Found(step.x, step.residual, step.jacobian, step.determinant, *told)


def _roughly(
    rod: RodModel, rough: RodModel, values: Callable[..., Any], last: Found, x: Unknowns
) -> tuple[Array, tuple[Unknowns, Any]]:
    """Slopes (k, k) at x (k,), and the conditions (k,) on a rod with what they tell: differences of
    those on the rougher one near the same contact, or the slopes of the last step. In one loop: the
    code of rods takes longest to compile.
    """
    places = jnp.concatenate([x[None], x + CHANGE * jnp.eye(len(x) + 1, len(x), -1)])

    def evaluate(state: tuple[Array, Array, Array, Any]) -> tuple[Array, Array, Array, Any]:
        row, most, rows, told = state
        first = row == 0
        either = partial(
            jax.tree.map, lambda one, other: one if one is other else jnp.where(first, one, other)
        )
        near = jnp.where(first, jnp.nan, told[0])
        residual, new = values(row_of(places, row), either(rod, rough), near)
        largest = jnp.max(jnp.abs(residual))
        kept = (last.residual < _NEARBY) & (largest < _KEPT * last.residual)
        most = jnp.where(first & ~kept, len(places) - 1, most)
        return row + 1, most, with_row(rows, residual, row), either(new, told)

    none, nan = jnp.zeros((), dtype=int), jnp.full((), jnp.nan)
    blank = jnp.zeros(places.shape), (nan, jnp.full(3, jnp.nan), nan, nan)
    _, most, rows, told = lax.while_loop(
        lambda state: state[0] <= state[1], evaluate, (none, none, *blank)
    )
    slopes = jnp.where(most > 0, (rows[2:] - rows[1]).T / CHANGE, last.jacobian)
    return slopes, (rows[0], told)


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
    walk, padded = _sized(legs)
    steps: Steps = walk((scene, law, np.asarray(legs.clear.shape[1])), padded)
    return chosen(steps, np.s_[:, : legs.clear.shape[1]])


def march_ahead(scene: Scene, law: Law, clamps: Clamp) -> None:
    """Compile in the background what the march through clamps (k, n, 3) needs."""
    walk, padded = _sized(entering(scene, law, clamps))
    walk.ahead((scene, law, np.asarray(0)), padded)


def _sized(legs: Legs) -> tuple[Lanes[Any, Any], Legs]:
    """The kernel that walks such lanes, and legs padded to its size."""
    count, n = legs.clear.shape
    # Each size is compiled separately: up to a block of short lanes share that of a trail.
    short = n <= _FAN and count > WIDTH
    size = _FAN if short else max(_SHORTEST_TRAIL, 1 << (n - 1).bit_length())

    def padded(rows: np.ndarray) -> np.ndarray:
        whole = np.zeros((count, size, *rows.shape[2:]), rows.dtype)
        whole[:, :n] = rows
        return whole

    clamp, clear, met, meeting = jax.tree.map(padded, legs[:4])
    legs = legs._replace(clamp=clamp, clear=clear, met=met, meeting=meeting)
    return (_fans if short else _trails), legs


def from_seeds(
    scene: Scene, law: Law, clamp: Clamp, seeds: State, tolerance: float = SHARP
) -> Steps:
    """Newton's method from states (k, …) at one clamp pose, to steps (k, …) in the same order: each
    is a first contact on a lane that then goes on as if it had not happened. The step from a
    residual within the tolerance is the last.
    """
    count, room = len(seeds.force), _SHORTEST_TRAIL - 1
    rows = -(-count // room)
    lane, position = np.indices((rows, _SHORTEST_TRAIL))
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


def _walk(shared: tuple[Scene, Law, Int[Array, ""]], legs: Legs) -> Steps:
    """Walk a lane through the first `count` of its positions; scene, law and count are shared."""
    scene, law, count = shared
    size = legs.clear.shape[0]
    nothing: Steps = jax.tree.map(
        lambda part: jnp.full((size, *part.shape), jnp.nan),
        Steps(legs.reached, *(legs.sign,) * 4),
    )
    steps = nothing._replace(mode=jnp.full(size, int(Mode.WAITING)))
    waiting = jnp.asarray(int(Mode.WAITING))
    begin = row_of(legs.clamp, legs.start)
    none = jnp.zeros(4 + scene.rod.unknowns)
    carry = _Carry(legs.reached, [none] * _ORDERS, jnp.zeros((), dtype=int), waiting)

    def advance(index: Array, state: tuple[_Carry, Steps]) -> tuple[_Carry, Steps]:
        carry, row = _advance(scene, law, legs, begin, index, state[0])
        return carry, with_row(state[1], row, index)

    walked: tuple[_Carry, Steps] = lax.fori_loop(0, count, advance, (carry, steps))
    return walked[1]


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
    expected = _expected(law, carry, foretold)
    # The tangential force starts from its last value, as sliding may stop or turn.
    guess = State(expected[:3], expected[3], last.state.lean, expected[4:])
    guess = jax.tree.map(lambda met, other: jnp.where(entering, met, other), meeting.state, guess)
    before = jax.tree.map(lambda met, other: jnp.where(entering, met, other), meeting, last)
    come_from = [
        jax.tree.map(
            partial(jnp.where, legs.fanned), begin, row_of(legs.clamp, jnp.maximum(index - k, 0))
        )
        for k in (1, 2, 3)
    ]
    side = before.state.point - come_from[0].point
    guess = law.begun(scene, guess, before, come_from[0], clamp)
    found = solved(scene, law, guess, clamp, before, side, active, legs.tolerance)

    converged = found.residual <= tolerance_of(scene, law)
    state = found.reached.state
    moved = _length(state.point - last.state.point)
    missed = jnp.min(joined(*(_length(state.point - order[:3]) for order in foretold[:-1])))
    tolerated = _MISS_FLOOR + _MISS * moved
    if not law.branch:
        # With friction the contact changes direction at a corner of the trail, without a jump.
        tolerated += JUMP * _clamp_miss(clamp, come_from, carry.age)
    now, then = state.force, last.state.force
    unlike = jnp.min(joined(*(jnp.abs(now - order[3]) for order in foretold[:-1])))
    other = unlike > _MISS * jnp.abs(now - then) + _REVERSED * jnp.maximum(now, then)
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
    changes = [jnp.where(age > order, here - at, 0.0) for order, at in enumerate(foretold[:-1])]
    following = _Carry(reached, [here, *changes], age, mode)
    following = jax.tree.map(
        lambda kept, new: jnp.where(legs.fanned & ~given, kept, new), carry, following
    )
    return following, Steps(reached, mode, found.figure, found.phase, found.residual)


def _length(vector: Float[Array, "n"]) -> Scalar:
    return jnp.sqrt(jnp.sum(vector**2))


def _expected(
    law: Law, carry: _Carry, foretold: list[Float[Array, "expected"]]
) -> Float[Array, "expected"]:
    """Point, force and the rod's own unknowns, extrapolated; without friction to the order that
    would have predicted the last position best: its error there is the difference of the next.
    """
    expected, least = foretold[_UNTESTED], jnp.asarray(jnp.inf)
    for order in range(_UNTESTED, _ORDERS - 1) if law.branch else ():
        missed = _BETTER * _length(carry.differences[order + 1])
        better = (carry.age > order) & (missed < least)
        expected = jnp.where(better, foretold[order], expected)
        least = jnp.where(better, missed / _BETTER, least)
    return expected


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
