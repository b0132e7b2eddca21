"""Events between two positions: bracketed roots along the branch, each evaluation an equilibrium of
its own.
"""

from enum import IntEnum

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int

from vibrissa.forward.equations import Scene, contact_state, newton_step
from vibrissa.forward.path import clamp_between
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.bracket import bracketed_root
from vibrissa.numerics.compiled import compiled

Scalar = Float[Array, ""]


class Indicator(IntEnum):
    """Which figure changes its sign."""

    FORCE = 0
    PHASE = 1
    CONE = 2


WIDTH = 16
"""Lanes of a block: events are few."""

# The guess improves with the bracket, so that two steps are enough wherever the last evaluations
# lie.
_ITERATIONS = 2


@compiled
def locate(
    scene: Scene,
    stretches: Float[Array, "blocks 14 width"],
    ends: Float[Array, "blocks 12 width"],
    indicator: Int[Array, "blocks width"],
) -> Float[Array, "blocks 5 width"]:
    """Fraction of the stretch and unknowns x (4) at which the indicator is zero.

    `ends` holds for both ends of the bracket the fraction, the unknowns and the indicator there (6
    + 6).
    """

    def one(
        stretch: Float[Array, "14"], ends: Float[Array, "12"], indicator: Int[Array, ""]
    ) -> Float[Array, "5"]:
        low, x_low, high, x_high = ends[0], ends[1:5], ends[6], ends[7:11]

        def solved(fraction: Scalar, guess: Float[Array, "4"]) -> tuple[Scalar, Float[Array, "4"]]:
            clamp = clamp_between(stretch, fraction)

            def iterate(_: Array | int, state: tuple[Array, Array]) -> tuple[Array, Array]:
                step = newton_step(scene, state[0], clamp)
                return step.x, jnp.stack([step.x[3], step.phase])

            x, figures = lax.fori_loop(0, _ITERATIONS, iterate, (guess, jnp.zeros(2)))
            return figures[indicator], x

        fraction, x = bracketed_root(solved, (low, high), (ends[5], ends[11]), (x_low, x_high))
        return jnp.concatenate([jnp.stack([fraction]), x])

    return lax.map(
        lambda block: jax.vmap(one, in_axes=(1, 1, 0), out_axes=1)(*block),
        (stretches, ends, indicator),
    )


_POLISHING_STEPS = 5
_POLISHED = 1e-12
_SETTLED = 1e-15
_FARTHEST = 0.05
ROUNDING = 1e-9
"""By how much a change of phase may lie outside its bracket."""


@compiled
def _change_conditions(
    scene: Scene,
    stretches: Float[AnyArray, "blocks 14 width"],
    y: Float[AnyArray, "blocks 5 width"],
) -> Float[Array, "blocks 30 width"]:
    """The five conditions of a change of phase at y = (x, fraction), and their Jacobian."""

    def one(stretch: Float[Array, "14"], y: Float[Array, "5"]) -> Float[Array, "30"]:
        def conditions(y: Float[Array, "5"]) -> tuple[Float[Array, "5"], Float[Array, "5"]]:
            state = contact_state(scene, y[:4], clamp_between(stretch, y[4]))
            # Both phases at once: no kink is left.
            both = jnp.stack([1 - state.rod.arc_length, 0.5 - state.rod.modulus])
            residual = jnp.concatenate([state.residual[:3], both])
            return residual, residual

        jacobian, residual = jax.jacfwd(conditions, has_aux=True)(y)
        return jnp.concatenate([residual, jacobian.ravel()])

    return lax.map(
        lambda block: jax.vmap(one, in_axes=1, out_axes=1)(*block),
        (jnp.asarray(stretches), jnp.asarray(y)),
    )


def polished(
    scene: Scene, stretches: Float[np.ndarray, "k 14"], y: Float[np.ndarray, "k 5"]
) -> tuple[Float[np.ndarray, "k 5"], Bool[np.ndarray, "k"]]:
    """Changes of phase by Newton's method on (x, fraction) with s₁ = 1 and k² = ½ both imposed, and
    where that converged near its start.
    """
    start, residual = y, np.full(len(y), np.inf)
    for _ in range(_POLISHING_STEPS):
        values = scene.in_blocks(_change_conditions, stretches, y, width=WIDTH)
        jacobian = values[:, 5:].reshape(-1, 5, 5)
        regular = np.isfinite(values).all(axis=1) & (
            np.abs(np.linalg.det(np.nan_to_num(jacobian))) > 0
        )
        jacobian = np.where(regular[:, None, None], jacobian, np.eye(5))
        right = np.where(regular[:, None], values[:, :5], 0.0)
        residual = np.where(regular, np.abs(right).max(axis=1), np.inf)
        if residual.max(initial=0.0) < _SETTLED:
            break
        y = y - np.linalg.solve(jacobian, right[..., None])[..., 0]
    return y, (residual < _POLISHED) & (np.abs(y - start)[:, :4].max(axis=1) < _FARTHEST)


def roots(
    scene: Scene,
    stretches: Float[np.ndarray, "k 14"],
    ends: Float[np.ndarray, "k 12"],
    indicator: Int[np.ndarray, "k"],
) -> Float[np.ndarray, "k 5"]:
    """Fraction and unknowns at the zero of the indicator between two ends: a change of phase by
    Newton's method, the rest by bracketing.
    """
    low, high, before, after = ends[:, 0], ends[:, 6], ends[:, 5], ends[:, 11]
    share = (before / (before - after))[:, None]
    found = ends[:, :5] + share * (ends[:, 6:11] - ends[:, :5])
    changes = indicator == Indicator.PHASE
    between, done = found.copy(), np.zeros(len(found), dtype=bool)

    def polish(rows: Int[np.ndarray, "rows"]) -> None:
        if rows.size:
            y, sound = polished(scene, stretches[rows], np.roll(found[rows], -1, axis=1))
            sound &= (y[:, 4] > low[rows] - ROUNDING) & (y[:, 4] < high[rows] + ROUNDING)
            found[rows[sound]] = np.roll(y[sound], 1, axis=1)
            done[rows[sound]] = True

    polish(np.flatnonzero(changes))
    left = np.flatnonzero(~done)
    if left.size:
        found[left] = scene.in_blocks(
            locate, stretches[left], ends[left], indicator[left], width=WIDTH
        )
        polish(left[changes[left]])
    # Where the states on the way have no solution, as of a rod that comes to lie along a face, what
    # lies between the ends in proportion.
    return np.where(np.isfinite(found).all(axis=1, keepdims=True), found, between)
