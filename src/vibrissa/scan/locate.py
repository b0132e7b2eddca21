"""Events between two positions: bracketed roots along the branch, each evaluation an equilibrium of its own."""

from enum import IntEnum

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.numerics.bracket import bracketed_root
from vibrissa.numerics.compiled import compiled
from vibrissa.scan.equations import Scene, newton_step
from vibrissa.scan.path import clamp_between

Scalar = Float[Array, ""]


class Indicator(IntEnum):
    """Which figure changes its sign."""

    FORCE = 0
    PHASE = 1


WIDTH = 16
"""Lanes of a block: events are few."""

# The guess improves with the bracket, so that two steps are enough wherever the last evaluations lie.
_ITERATIONS = 2


@compiled
def locate(
    scene: Scene,
    stretches: Float[Array, "blocks 14 width"],
    ends: Float[Array, "blocks 12 width"],
    indicator: Int[Array, "blocks width"],
) -> Float[Array, "blocks 5 width"]:
    """Fraction of the stretch and unknowns x (4) at which the indicator is zero.

    `ends` holds for both ends of the bracket the fraction, the unknowns and the indicator there (6 + 6).
    """

    def one(stretch: Float[Array, "14"], ends: Float[Array, "12"], indicator: Int[Array, ""]) -> Float[Array, "5"]:
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

    return lax.map(lambda block: jax.vmap(one, in_axes=(1, 1, 0), out_axes=1)(*block), (stretches, ends, indicator))
