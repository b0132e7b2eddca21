"""Many trails in step: each position is started from the last, extrapolated, and solved by Newton's
method.

The march does what goes smoothly. Where a lane does not converge, jumps, changes the sign of its
Jacobian, or finds the straight rod in the object without having met it, it stops that lane as lost;
`follow` resolves the stretch, and the march resumes behind it.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Bool, Float, Int

from vibrissa.forward.equations import Clamp, NewtonStep, Scene, newton_step
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.compiled import compiled


class Mode(IntEnum):
    """What a lane does at a position."""

    FREE = 0
    CONTACT = 1
    LOST = 2
    WAITING = 3


class Legs(NamedTuple):
    """What the march needs of each lane, in blocks; the last axis is the lane."""

    point: Float[AnyArray, "blocks n 3 width"]
    tangent: Float[AnyArray, "blocks n 3 width"]
    clear: Bool[AnyArray, "blocks n width"]
    """The straight rod is outside the object."""
    met: Bool[AnyArray, "blocks n width"]
    """First contact of the straight rod lies on the stretch that ends here."""
    meeting: Float[AnyArray, "blocks n size width"]
    """State at that first contact."""
    start: Int[AnyArray, "blocks width"]
    """Index at which the lane enters, with `mode` and `x` given there."""
    mode: Int[AnyArray, "blocks width"]
    x: Float[AnyArray, "blocks size width"]
    sign: Float[AnyArray, "blocks width"]
    """Sign of the Jacobian's determinant: negative on a stable branch."""


class Steps(NamedTuple):
    """What the march found, in blocks."""

    x: Float[Array, "blocks n size width"]
    mode: Int[Array, "blocks n width"]
    figure: Float[Array, "blocks n width"]
    """Determinant of the Jacobian; with friction, how far outside the cone the force would lie
    without sliding.
    """
    phase: Float[Array, "blocks n width"]


class _Carry(NamedTuple):
    x: Array
    before: Array
    second_before: Array
    age: Array
    mode: Array
    sign: Array


TOLERANCE = 1e-9
"""Largest residual from which one more quadratic step is taken, and no other."""

_MOST_ITERATIONS = 12
JUMP = 8.0
JUMP_FLOOR = 0.02
_MISS = 0.7
_MISS_FLOOR = 0.005


class Solved(NamedTuple):
    """What Newton's method ends with; lanes last."""

    x: Float[Array, "size width"]
    residual: Float[Array, "width"]
    figure: Float[Array, "width"]
    phase: Float[Array, "width"]


class Solver(NamedTuple):
    """Newton's method for one position of all lanes."""

    solve: Callable[[Scene, Array, Clamp, Array, Array, Array], Solved]
    """Of scene, guess (size, width), clamps, the lanes that matter, and of before the states (size,
    width) and clamp points (3, width).
    """
    branch: bool
    """Whether the figure keeps its sign."""


March: TypeAlias = Callable[[Scene, Legs, AnyArray, AnyArray], Steps]


def marching(solver: Solver) -> March:
    """A march with a given solver."""

    @compiled
    def march(
        scene: Scene, legs: Legs, count: Int[AnyArray, ""], blocks: Int[AnyArray, ""]
    ) -> Steps:
        """Walk the lanes of the first `blocks` blocks through the first `count` positions."""
        legs = Legs(*(jnp.asarray(part) for part in legs))
        lanes = legs.point.shape[0]
        steps = Steps(*(jnp.broadcast_to(part, (lanes, *part.shape)) for part in _nothing(legs)))

        def walk(index: Array, steps: Steps) -> Steps:
            found = _march_block(solver, scene, Legs(*(part[index] for part in legs)), count)
            return Steps(
                *(whole.at[index].set(part) for whole, part in zip(steps, found, strict=True))
            )

        walked: Steps = lax.fori_loop(0, blocks, walk, steps)
        return walked

    return march


def _nothing(legs: Legs) -> Steps:
    capacity, size, width = legs.meeting.shape[-3:]
    nothing = jnp.full((capacity, width), jnp.nan)
    return Steps(
        jnp.full((capacity, size, width), jnp.nan),
        jnp.full((capacity, width), int(Mode.WAITING)),
        nothing,
        nothing,
    )


def _march_block(solver: Solver, scene: Scene, legs: Legs, count: Int[AnyArray, ""]) -> Steps:
    steps = _nothing(legs)
    width = legs.point.shape[-1]
    waiting, start = jnp.full(width, int(Mode.WAITING)), jnp.asarray(legs.x)
    carry = _Carry(
        start, start, start, jnp.zeros(width, dtype=int), waiting, jnp.asarray(legs.sign)
    )

    def advance(index: Array, state: tuple[_Carry, Steps]) -> tuple[_Carry, Steps]:
        carry, steps = state
        carry, row = _advance(solver, scene, legs, index, carry)
        return carry, Steps(
            *(whole.at[index].set(part) for whole, part in zip(steps, row, strict=True))
        )

    walked: tuple[_Carry, Steps] = lax.fori_loop(
        jnp.min(legs.start), count, advance, (carry, steps)
    )
    return walked[1]


def _advance(
    solver: Solver, scene: Scene, legs: Legs, index: Array, carry: _Carry
) -> tuple[_Carry, Steps]:
    clamp = Clamp(legs.point[index], legs.tangent[index])
    free, touching = carry.mode == Mode.FREE, carry.mode == Mode.CONTACT
    entering = free & legs.met[index]
    active = touching | entering
    met = legs.meeting[index]
    guess = _extrapolated(carry)
    start, before = jnp.where(entering, met, guess), jnp.where(entering, met, carry.x)
    x, residual, figure, phase = solver.solve(
        scene, start, clamp, active, before, legs.point[jnp.maximum(index - 1, 0)]
    )

    solved = residual <= TOLERANCE
    moved, missed = _distance(x, carry.x), _distance(x, guess)
    clamp_moved = _clamp_motion(legs, index)
    tolerated = _MISS_FLOOR + _MISS * moved
    if not solver.branch:
        # With friction the contact turns off its way at a corner of the trail, without a jump, and
        # the guesses behind it still carry that on.
        strides = _distance(carry.x, carry.before), _distance(carry.before, carry.second_before)
        tolerated = (
            _MISS_FLOOR
            + _MISS * jnp.maximum(moved, jnp.maximum(*strides))
            + JUMP * _clamp_miss(legs, index, carry.age)
        )
    misses = (carry.age >= 1) & (missed > tolerated)
    leaps = touching & ((moved > JUMP_FLOOR + JUMP * clamp_moved) | misses)
    # A contact that pulls is one that has been lost; the solution beyond tells by how much.
    released = touching & solved & ~leaps & (x[3] < 0)
    held = active & solved & ~leaps & (x[3] >= 0)
    if solver.branch:
        held &= figure * carry.sign > 0
    clear = legs.clear[index]
    mode = jnp.where(held, Mode.CONTACT, Mode.LOST)
    mode = jnp.where((free & ~entering & clear) | (released & clear), Mode.FREE, mode)
    given = index == legs.start
    mode = jnp.where(given, legs.mode, mode)
    mode = jnp.where((carry.mode == Mode.WAITING) & ~given, Mode.WAITING, mode)
    mode = jnp.where(carry.mode == Mode.LOST, Mode.LOST, mode)
    x = jnp.where(given, legs.x, x)

    fresh = entering | given
    age = jnp.where(fresh, 0, carry.age + 1)
    following = _Carry(
        x, jnp.where(fresh, x, carry.x), jnp.where(fresh, x, carry.before), age, mode, carry.sign
    )
    return following, Steps(x, mode, figure, phase)


def _distance(x: Array, y: Array) -> Float[Array, "width"]:
    """Between two contact points."""
    return jnp.sqrt(jnp.sum((x - y)[:3] ** 2, axis=0))


def _extrapolated(carry: _Carry) -> Float[Array, "size width"]:
    return _next(carry.x, carry.before, carry.second_before, carry.age)


def _next(
    last: Array, before: Array, second_before: Array, age: Array
) -> Float[Array, "size width"]:
    linear = 2 * last - before
    quadratic = 3 * (last - before) + second_before
    return jnp.where(age >= 2, quadratic, jnp.where(age >= 1, linear, last))


def _clamp_miss(legs: Legs, index: Array, age: Array) -> Float[Array, "width"]:
    """How far the clamp is from where its motion would have taken it, by the rule of
    `_extrapolated`.
    """
    last, before, second_before = (jnp.maximum(index - back, 0) for back in (1, 2, 3))
    misses = (
        at[index] - _next(at[last], at[before], at[second_before], age)
        for at in (legs.point, legs.tangent)
    )
    return jnp.sqrt(sum(jnp.sum(miss**2, axis=0) for miss in misses))


def _clamp_motion(legs: Legs, index: Array) -> Float[Array, "width"]:
    before = jnp.maximum(index - 1, 0)
    moved = jnp.sum((legs.point[index] - legs.point[before]) ** 2, axis=0)
    return jnp.sqrt(moved + jnp.sum((legs.tangent[index] - legs.tangent[before]) ** 2, axis=0))


def iterated(step: Callable[[Array], Solved], guess: Array, active: Array, most: int) -> Solved:
    """Newton's method until every active lane has converged."""

    def unfinished(state: tuple[Solved, Array]) -> Array:
        solved, iteration = state
        return jnp.any(active & (solved.residual > TOLERANCE)) & (iteration < most)

    def iterate(state: tuple[Solved, Array]) -> tuple[Solved, Array]:
        return step(state[0].x), state[1] + 1

    width = active.shape[0]
    nothing = jnp.full(width, jnp.nan)
    start = Solved(guess, jnp.full(width, jnp.inf), nothing, nothing)
    solved: tuple[Solved, Array] = lax.while_loop(
        unfinished, iterate, (start, jnp.zeros((), dtype=int))
    )
    return solved[0]


def _frictionless(
    scene: Scene, guess: Array, clamp: Clamp, active: Array, before: Array, clamp_before: Array
) -> Solved:
    def step(x: Array, clamp: Clamp, reached: Array) -> NewtonStep:
        return newton_step(scene, x, clamp, reached=reached)

    axes = NewtonStep(1, 0, 0, 0)  # type: ignore[arg-type]
    newton, reached = jax.vmap(step, in_axes=1, out_axes=axes), before[:3] - clamp_before
    return iterated(lambda x: Solved(*newton(x, clamp, reached)), guess, active, _MOST_ITERATIONS)


march = marching(Solver(_frictionless, branch=True))
