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
    DETERMINANT = 2


_ITERATIONS = 4


@compiled
def locate(
    scene: Scene,
    stretches: Float[Array, "blocks 14 width"],
    ends: Float[Array, "blocks 10 width"],
    indicator: Int[Array, "blocks width"],
) -> Float[Array, "blocks 5 width"]:
    """Fraction of the stretch and unknowns x (4) at which the indicator is zero.

    `ends` holds for both ends of the bracket the fraction and the unknowns there (5 + 5).
    """

    def one(stretch: Float[Array, "14"], ends: Float[Array, "10"], indicator: Int[Array, ""]) -> Float[Array, "5"]:
        low, x_low, high, x_high = ends[0], ends[1:5], ends[5], ends[6:10]

        def solved(fraction: Scalar) -> tuple[Float[Array, "4"], Float[Array, "3"]]:
            clamp = clamp_between(stretch, fraction)
            share = (fraction - low) / jnp.where(high > low, high - low, 1.0)

            def iterate(_: int, state: tuple[Array, Array]) -> tuple[Array, Array]:
                step = newton_step(scene, state[0], clamp)
                return step.x, jnp.stack([step.x[3], step.phase, step.determinant])

            return lax.fori_loop(0, _ITERATIONS, iterate, (x_low + share * (x_high - x_low), jnp.zeros(3)))

        def value(fraction: Scalar) -> Scalar:
            return solved(fraction)[1][indicator]

        fraction = bracketed_root(value, low, high, value(low), value(high))
        return jnp.concatenate([jnp.stack([fraction]), solved(fraction)[0]])

    return lax.map(lambda block: jax.vmap(one, in_axes=(1, 1, 0), out_axes=1)(*block), (stretches, ends, indicator))
