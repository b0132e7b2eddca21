"""Events between two positions: bracketed roots along the way, each evaluation an equilibrium of
its own.
"""

from enum import IntEnum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.contact import Law, Reached, Scene
from vibrissa.forward.march import once
from vibrissa.forward.path import Stretch
from vibrissa.numerics.bracket import bracketed_root
from vibrissa.numerics.lanes import lanes

Scalar = Float[Any, ""]


class Indicator(IntEnum):
    """Which figure changes its sign."""

    FORCE = 0
    PHASE = 1
    CONE = 2


class End(NamedTuple):
    """One end of a bracket: fraction of the stretch, state, and the indicator there."""

    fraction: Scalar
    reached: Reached
    value: Scalar


class Located(NamedTuple):
    """Where the indicator is zero."""

    fraction: Scalar
    reached: Reached


_ITERATIONS = {True: 2, False: 4}
"""The guess improves with the bracket, so that few steps are enough wherever the last evaluations
lie; with friction, from whose corners Newton's method starts badly, twice as many.
"""


@lanes(width=16, blocks=4, rarely=True)
def _located(
    shared: tuple[Scene, Law],
    stretch: Stretch,
    low: End,
    high: End,
    indicator: Int[Any, ""],
) -> Located:
    scene, law = shared
    before = None if law.branch else low.reached

    def value(fraction: Scalar, guess: Reached) -> tuple[Scalar, Reached]:
        clamp = stretch.clamp(fraction)

        def iterate(_: Array | int, state: tuple[Reached, Array]) -> tuple[Reached, Array]:
            found = once(scene, law, state[0].state, clamp, before, None)
            figures = jnp.stack([found.reached.state.force, found.phase, found.figure])
            return found.reached, figures

        reached, figures = lax.fori_loop(0, _ITERATIONS[law.branch], iterate, (guess, jnp.zeros(3)))
        return figures[indicator], reached

    return Located(
        *bracketed_root(
            value,
            (low.fraction, high.fraction),
            (low.value, high.value),
            (low.reached, high.reached),
        )
    )


def located(
    scene: Scene,
    law: Law,
    stretches: Stretch,
    low: End,
    high: End,
    indicator: Int[np.ndarray, "k"],
) -> Located:
    """Where indicators are zero on stretches (k, …), between two ends of opposite signs; with
    friction each a step from the first.
    """
    found = _located((scene, law), stretches, low, high, indicator)
    # Where a step on the way does not converge, as next to a contact that jumps or of a rod that
    # comes to lie along a face, what lies between the ends in proportion.
    gap = low.value - high.value
    share = low.value / np.where(gap == 0, 1.0, gap)
    sound = np.isfinite(found.reached.state.flat_rows).all(axis=1) & np.isfinite(found.fraction)

    def between(first: np.ndarray, last: np.ndarray, root: np.ndarray) -> np.ndarray:
        rows = (-1,) + (1,) * (first.ndim - 1)
        proportional = first + share.reshape(rows) * (last - first)
        return np.where(sound.reshape(rows), root, proportional)

    ends = (Located(end.fraction, end.reached) for end in (low, high))
    result: Located = jax.tree.map(between, *ends, found)
    return result
