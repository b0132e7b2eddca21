"""Rods under loads: what the loads are, their resultants at the clamp by Newton's method, and
whether the rod stands.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Bool, Float, Int

from vibrissa.mechanics.line import across_of
from vibrissa.numerics.linear import solve_pivoted
from vibrissa.numerics.vectors import dot, joined

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]

_LOAD_STEPS, _LOAD_NEAR, _LOAD_SETTLED, _LOAD_FOUND = 25, 1e-3, 1e-13, 1e-8
"""Most Newton steps to the loads' resultants, and sizes [EI/L²] of a step: from which on slopes are
kept, that ends them, and up to which resultants count as found.
"""
_HARDLY_BENT = 0.5
"""Largest elastic curvature [1/L] of a rod on which the moments at tip and clamp are alike."""
_LARGEST_CHANGE = 2.0
"""Of the resultants in one such step [EI/L²]."""
_LOAD_SHARE, LARGEST_LOAD = 8.0, 90.0
"""By how much loads [EI/L²] grow at a time from none, so that a rod as soft as a rope finds the
shape that it takes on its own; and up to which it does (measured: from 100 on, rods that are
clamped upright may end up curled).
"""
_TINY = 1e-300


class Load(eqx.Module):
    """Force per length on the rod [EI/L³], world axes."""

    @property
    @abstractmethod
    def alike_everywhere(self) -> bool:
        """Whether it does not depend on the position."""

    @abstractmethod
    def per_length(self, s: Scalar, position: Vector, tangent: Vector, section: Any) -> Vector:
        """At an arc length and a position [L]; `section` holds whatever varies along the rod."""


class Share(Load):
    """A share of another load."""

    whole: Load
    share: Scalar

    @property
    def alike_everywhere(self) -> bool:
        """As in `Load`."""
        return self.whole.alike_everywhere

    def per_length(self, s: Scalar, position: Vector, tangent: Vector, section: Any) -> Vector:
        """As in `Load`."""
        return self.share * self.whole.per_length(s, position, tangent, section)


def shares_of(load: Vector) -> Int[Array, ""]:
    """In how many shares a load per length (3,) [EI/L³] is to grow."""
    count = jnp.ceil(jnp.sqrt(dot(load, load)) / _LOAD_SHARE)
    return jnp.clip(count, 1, math.ceil(LARGEST_LOAD / _LOAD_SHARE)).astype(int)


class _Balance(NamedTuple):
    """Unknowns under a share of the load, the last step's Jacobian and size, how many steps there
    were, and which share it is.
    """

    x: Array
    jacobian: Array
    size: Scalar
    steps: Array
    given: Array


def balanced(
    left: Callable[[Array, Any], Array],
    begin: Array,
    seen_at: Callable[[Array], Array] = lambda unknowns: unknowns,
    shares: Any = 1,
) -> tuple[Array, Bool[Array, ""]]:
    """Unknowns that leave nothing under the whole load, by Newton's method from given ones, as
    the load grows from nothing in so many equal shares; and whether they were found. With
    derivatives with respect to whatever `left` closes over, taken at `seen_at` of the unknowns,
    which differs from them by rounding.
    """

    def solve(_: Callable[[Array], Array], begin: Array) -> tuple[Array, Scalar]:
        slopes = jax.jacfwd(lambda x, share: (left(x, share),) * 2, has_aux=True)

        def unfinished(at: _Balance) -> Array:
            return ((at.size > _LOAD_SETTLED) | (at.given < shares)) & (at.steps < _LOAD_STEPS)

        def refine(at: _Balance) -> _Balance:
            more = (at.size < _LOAD_NEAR) & (at.given < shares)
            given = at.given + more
            jacobian, value = lax.cond(
                (at.size > _LOAD_NEAR) | more,
                slopes,
                lambda x, share: (at.jacobian, left(x, share)),
                at.x,
                given / shares,
            )
            change, _ = solve_pivoted(jacobian, value)
            size = jnp.max(jnp.abs(change))
            part = jnp.minimum(1.0, _LARGEST_CHANGE / jnp.maximum(size, _TINY))
            steps = jnp.where(more, 1, at.steps + 1)
            return _Balance(at.x - part * change, jacobian, size, steps, given)

        jacobian, none = jnp.zeros((len(begin),) * 2), jnp.zeros((), dtype=int)
        start = _Balance(begin, jacobian, jnp.asarray(jnp.inf), none, none + 1)
        last = lax.while_loop(unfinished, refine, start)
        return seen_at(last.x), last.size

    def tangent(linear: Callable[[Array], Array], right: Array) -> Array:
        return solve_pivoted(jax.jacfwd(linear)(jnp.zeros_like(right)), right)[0]

    found, size = lax.custom_root(lambda x: left(x, 1.0), begin, solve, tangent, has_aux=True)
    return found, size < _LOAD_FOUND


def stands(
    by_load: Float[Array, "6 6"], turn: Float[Array, "3 6"], tangent: Vector, strain: Scalar
) -> Bool[Array, ""]:
    """Whether a rod without contact is stable: whether small moments across its tip turn it their
    own way. Given are the derivatives of force and moment at the tip, and of its tangent, with
    respect to force and moment at the clamp.

    Under more than its second critical load an upright column answers in that way again; but while
    the rod is hardly bent, its clamp then has to hold against the moment's sense.
    """
    none = jnp.zeros(3)
    across = across_of(tangent)
    moments = across, jnp.cross(tangent, across)
    at_clamp = [solve_pivoted(by_load, joined(none, moment))[0] for moment in moments]

    def positive(answers: list[Vector]) -> Bool[Array, ""]:
        (a, b), (c, d) = ([dot(moment, answer) for answer in answers] for moment in moments)
        return (a > 0) & (a * d > ((b + c) / 2) ** 2)

    turns = [jnp.cross(tangent, turn @ answer) for answer in at_clamp]
    hardly = strain < _HARDLY_BENT
    return positive(turns) & (positive([answer[3:] for answer in at_clamp]) | ~hardly)
