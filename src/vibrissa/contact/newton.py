"""Newton's method for the conditions of contact, and derivatives of what it finds."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from vibrissa.numerics.derivatives import exact
from vibrissa.numerics.linear import solve_small

Scalar = Float[Any, ""]
Unknowns = Float[Array, "unknowns"]
Told = TypeVar("Told")

_LONGEST_STEP = 0.3
"""Most [L] that the contact point moves in one step."""
_CAUTIOUS_STEP = 0.2
"""The same from a start near the root, where a longer step leads to another equilibrium."""
_MET, _ASTRAY = 1e-9, 1e-5
"""Once the conditions are met to the first, a step longer than the second [L] comes from a singular
Jacobian: it would lead away.
"""
_SINGULAR = 1e-12
"""Determinant below which only rounding is left: the Jacobian's entries are of order one. It counts
as positive, the unstable sign, so that a branch is always followed from where its direction is
certain.
"""
_CONVERGED = 1e-11
_MOST_STEPS = 25


class Step(NamedTuple):
    """One step of Newton's method."""

    x: Unknowns
    residual: Scalar
    """Largest residual before the step."""
    determinant: Scalar
    """Of the Jacobian before the step: its sign changes where an equilibrium without friction gains
    or loses stability.
    """
    jacobian: Float[Array, "unknowns unknowns"]


def signed(determinant: Scalar, xp: Any = jnp) -> Scalar:
    """A determinant whose sign can be relied on; `xp` is NumPy or JAX's."""
    return xp.where(abs(determinant) < _SINGULAR, _SINGULAR, determinant)


def step_from(
    conditions: Callable[[Unknowns], tuple[Unknowns, Told]],
    x: Unknowns,
    *,
    derivatives: Callable[..., Any] = exact,
    cautious: bool = False,
) -> tuple[Step, Told]:
    """Semi-smooth Newton step; the contact point x[:3] moves by at most 0.3 L.

    A cautious step is at most 0.2 L long, and is taken even where a singular Jacobian leaves the
    state open: such a state is then no root.

    `conditions` returns the residual, and whatever else is wanted at x; `derivatives`, as in
    `vibrissa.numerics.derivatives`, its Jacobian or nearly so.
    """
    jacobian, (residual, told) = derivatives(conditions, x)
    step, determinant = solve_small(jacobian, residual)
    distance = jnp.sqrt(jnp.sum(step[:3] ** 2))
    longest = _CAUTIOUS_STEP if cautious else _LONGEST_STEP
    share = jnp.minimum(1.0, longest / jnp.maximum(distance, longest))
    largest = jnp.max(jnp.abs(residual))
    there = (not cautious) & (largest <= _MET) & ~(distance < _ASTRAY)
    return Step(jnp.where(there, x, x - share * step), largest, signed(determinant), jacobian), told


def iterated(
    residual: Callable[[Unknowns], Unknowns],
    start: Unknowns,
    derivatives: Callable[..., Any] = exact,
) -> Unknowns:
    """Root of conditions by Newton's method."""

    def advance(state: tuple[Unknowns, Scalar, Array]) -> tuple[Unknowns, Scalar, Array]:
        step, _ = step_from(
            lambda x: (residual(x), ()), state[0], derivatives=derivatives, cautious=True
        )
        return step.x, step.residual, state[2] + 1

    def unfinished(state: tuple[Unknowns, Scalar, Array]) -> Array:
        return (state[1] > _CONVERGED) & (state[2] < _MOST_STEPS)

    first = (start, jnp.asarray(jnp.inf), jnp.zeros((), dtype=int))
    found: Unknowns = lax.while_loop(unfinished, advance, first)[0]
    return found


def root(residual: Callable[[Unknowns], Unknowns], start: Unknowns) -> Unknowns:
    """The same, differentiable with respect to every θ that `residual` closes over; derivatives are
    those of the conditions, not of the iterations.
    """

    def tangent(linear: Callable[[Unknowns], Unknowns], right: Unknowns) -> Unknowns:
        return solve_small(jax.jacfwd(linear)(jnp.zeros_like(right)), right)[0]

    found: Unknowns = lax.custom_root(residual, start, iterated, tangent)
    return found
