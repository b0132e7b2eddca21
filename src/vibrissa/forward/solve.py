"""Newton's method for one position of a clamp."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Bool, Float

from vibrissa.contact import Law, Reached, Scene, State, Touching, step_from, touching
from vibrissa.mechanics.model import Clamp, RodModel
from vibrissa.numerics.derivatives import CHANGE, exact
from vibrissa.numerics.rows import row_of, with_row

Scalar = Float[Any, ""]
Unknowns = Float[Array, "unknowns"]
Jacobian = Float[Array, "unknowns unknowns"]

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
MOST_ITERATIONS = {True: 12, False: 25}
"""On a branch, where a poor guess is better left to `follow`; and with friction, whose conditions
have corners.
"""


def tolerance_of(scene: Scene, law: Law) -> float:
    """Largest residual from which the next Newton step is the last."""
    return scene.rod.last_step if law.branch else RUBBING


class Solved(NamedTuple):
    """Result of Newton's method."""

    reached: Reached
    residual: Scalar
    figure: Scalar
    phase: Scalar
    jacobian: Jacobian


def solved(
    scene: Scene,
    law: Law,
    guess: State,
    clamp: Clamp,
    before: Reached | None,
    side: Float[Any, "3"] | None,
    active: Bool[Any, ""],
    tolerance: Scalar,
    slopes: Jacobian | None = None,
) -> Solved:
    """Newton's method for one position, given the previous one, if the lane is active; the step
    from a residual within the tolerance is the last. Slopes that are known, and not NaN, serve from
    near the solution.
    """

    def conditions(x: Unknowns, rod: RodModel, near: Scalar | None) -> tuple[Unknowns, Touching]:
        own = scene._replace(rod=rod)
        found = touching(own, law, State.of(x, rod.unknowns), clamp, before, side, near)
        return found.residual, found

    found = newton(scene.rod, law, conditions, guess.flat, tolerance, slopes, active=active)
    reached = Reached(State.of(found.x, scene.rod.unknowns), found.arc_length, found.tangent)
    figure = found.determinant if law.branch else found.beyond
    return Solved(reached, found.residual, figure, found.phase, found.jacobian)


class Found(NamedTuple):
    """Where Newton's method ended; everything but `x` is from before its last step."""

    x: Unknowns
    residual: Scalar
    jacobian: Jacobian
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
    slopes: Jacobian | None = None,
    *,
    active: Bool[Any, ""] | bool = True,
) -> Found:
    """Newton's method for conditions on a rod, or on the one that gives slopes, near an arc length
    if that is known; the step from a residual within the tolerance is the last. Slopes as in
    `solved`.
    """

    def iterate(state: tuple[Found, Array]) -> tuple[Found, Array]:
        return _once(rod, law, conditions, state[0]), state[1] + 1

    def unfinished(state: tuple[Found, Array]) -> Array:
        return active & (state[0].residual > tolerance) & (state[1] < MOST_ITERATIONS[law.branch])

    nan = jnp.full((), jnp.nan)
    blank = jnp.full((len(guess),) * 2, jnp.nan)
    known = blank if slopes is None else slopes
    # Known slopes stand for those of a step that led near the solution.
    before = jnp.where(jnp.isfinite(known[0, 0]), _NEARBY, jnp.inf)
    start = Found(guess, before, known, nan, nan, jnp.full(3, jnp.nan), nan, nan)
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
        kept = (last.residual <= _NEARBY) & (largest < _KEPT * last.residual)
        most = jnp.where(first & ~kept, len(places) - 1, most)
        return row + 1, most, with_row(rows, residual, row), either(new, told)

    none, nan = jnp.zeros((), dtype=int), jnp.full((), jnp.nan)
    blank = jnp.zeros(places.shape), (nan, jnp.full(3, jnp.nan), nan, nan)
    _, most, rows, told = lax.while_loop(
        lambda state: state[0] <= state[1], evaluate, (none, none, *blank)
    )
    slopes = jnp.where(most > 0, (rows[2:] - rows[1]).T / CHANGE, last.jacobian)
    return slopes, (rows[0], told)
