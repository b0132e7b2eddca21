"""Explicit Runge–Kutta methods of Dormand and Prince for states that are trees of arrays.

E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, sec. II.5;
coefficients from SciPy.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Float
from scipy.integrate import DOP853, RK45

from vibrissa.numerics.rows import row_of, with_row

Scalar = Float[Any, ""]
State = TypeVar("State")


class Scheme(NamedTuple):
    """Coefficients of a method, of which the first `count` stages of k are its own."""

    stages: Float[Any, "k k"]
    nodes: Float[Any, "k"]
    weights: Float[Any, "k"]
    count: Any


_FEW, _MOST = len(RK45.B), len(DOP853.B)


def _scheme(a: np.ndarray, c: np.ndarray, b: np.ndarray) -> Scheme:
    """All have as many stages, so that the same code does for each."""
    count = len(b)
    stages, nodes, weights = np.zeros((_MOST, _MOST)), np.zeros(_MOST), np.zeros(_MOST)
    stages[:count, : a.shape[1]], nodes[:count], weights[:count] = a, c[:count], b
    return Scheme(stages, nodes, weights, np.asarray(count))


ORDER_8 = _scheme(DOP853.A, DOP853.C, DOP853.B)
ORDER_5 = _scheme(RK45.A, RK45.C, RK45.B)
_THIRD, _FIFTH, _SHARE = DOP853.E3[:-1], DOP853.E5[:-1], 0.1
"""Differences to the two formulas of lower order that the method holds, of which its estimate of
the error is made (ibid., sec. II.10).
"""
_TOO_LARGE = 50.0
"""By which the method's estimate exceeds errors up to 1e-5 (measured: 90 or more)."""
_TINY = 1e-300


def stepped(
    slope: Callable[[Scalar, State, Any], State],
    at: State,
    start: Scalar,
    h: Scalar,
    stages: Any,
    scheme: Scheme,
) -> tuple[State, State, Array]:
    """One step from a place: the state after it, the slope where it begins, and the slopes at all
    stages, as rows (k, …) of one array. `slope` is given a place, the state there, and the stage's
    row of `stages`.
    """
    # One array: XLA spends far longer on a loop over many small ones.
    begin, state_of = ravel_pytree(at)

    def stage(index: Array, slopes: Array) -> Array:
        own, weights, node = row_of((stages, scheme.stages, scheme.nodes), index)
        # At first there are few: all that a method of order 5 has.
        before = lax.cond(
            index <= _FEW,
            lambda: _sum(weights[:_FEW], slopes[:_FEW]),
            lambda: _sum(weights, slopes),
        )
        here = state_of(begin + h * before)
        row, _ = ravel_pytree(slope(start + h * node, here, own))
        return with_row(slopes, row, index)

    # A loop, not a sequence: a fifth of the time to compile, and no slower.
    slopes = lax.fori_loop(0, scheme.count, stage, jnp.zeros((_MOST, begin.size)))
    return (
        state_of(begin + h * _sum(jnp.asarray(scheme.weights), slopes)),
        state_of(slopes[0]),
        slopes,
    )


def error_of_order_8(h: Scalar, slopes: Float[Array, "k n"]) -> Scalar:
    """Estimated error of a step of `ORDER_8`, from its slopes."""
    slopes = lax.stop_gradient(slopes)
    third, fifth = (jnp.sum((h * _sum(of, slopes)) ** 2) for of in (_THIRD, _FIFTH))
    error: Scalar = fifth / (_TOO_LARGE * jnp.sqrt(fifth + _SHARE**2 * third + _TINY))
    return error


def _sum(weights: Any, slopes: Float[Array, "k n"]) -> Float[Array, "n"]:
    return jnp.sum(weights[:, None] * slopes, axis=0)
