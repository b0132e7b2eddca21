"""The spatial line of a rod that is not quite ideal, from its base wrench: Kirchhoff's equations,
for derivatives about the straight uniform rod.

With n and m the force and moment that the rod ahead exerts on the part behind, t the tangent and d
the clamp's x axis carried along without twist,

    r' = t,   t' = κ × t,   d' = κ × d,   m' = −t × n,   n' = −q,   κ = m/(1 − τs)⁴ + t × (c₁ d + c₂
    t × d),

with base values n = −f0, m = −m0. τ is the share by which the radius has shrunk at the tip, c the
rest curvature in the clamp's axes, q the load per length. Lengths in L, forces in EI/L² of the
base. Twist does not matter to first order: without imperfection there is none.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from vibrissa.inverse.inverse import invert
from vibrissa.numerics.blocks import AnyArray

STEPS = 32
"""Of Runge and Kutta's method of fourth order: 1e-7 of a rod bent by a right angle."""
WRENCH, TAPER, CURVATURE, LOAD = slice(0, 6), 6, slice(7, 9), slice(9, 12)
"""What the derivatives are by: the base wrench (6), τ, c (2) and q (3), clamp axes."""
PARAMETERS = 12
_NEWTON_STEPS = 2
_FARTHEST = 0.2
"""Newton's steps to the contact of a rod that is not ideal, and the longest of them [L]."""


class End(NamedTuple):
    """The rod at an arc length, clamp axes: vectors (k, 3), or their derivatives (k, 3, 12), traced
    or not.
    """

    moment: Any
    """Zero at a contact."""
    force: Any
    """Of the contact on the rod."""
    tangent: Any
    reach: Any


@jax.jit
def first_zeros(wrench: Float[AnyArray, "k 6"]) -> Float[Array, "k"]:
    """s₁ of ideal rods with these base wrenches."""
    tangent = jnp.array([0.0, 0.0, 1.0])
    return jax.vmap(lambda one: invert(one[:3], one[3:], tangent).arc_length)(jnp.asarray(wrench))


@jax.jit
def zeros_from(
    parameters: Float[AnyArray, "k 12"], arc_length: Float[AnyArray, "k"]
) -> Float[Array, "k"]:
    """s₁ of rods that are not ideal, by Newton's method from those of ideal ones."""

    def one(parameters: Float[Array, "12"], arc_length: Float[Array, ""]) -> Float[Array, ""]:
        def step(_: Array | int, s: Float[Array, ""]) -> Float[Array, ""]:
            end = _end(parameters, s)
            rate = -jnp.cross(end.tangent, end.force)
            return s - jnp.clip(
                jnp.sum(end.moment * rate) / jnp.sum(rate**2), -_FARTHEST, _FARTHEST
            )

        return lax.fori_loop(0, _NEWTON_STEPS, step, arc_length)

    return jax.vmap(one)(jnp.asarray(parameters), jnp.asarray(arc_length))


@jax.jit
def ends(parameters: Float[AnyArray, "k 12"], arc_length: Float[AnyArray, "k"]) -> tuple[End, End]:
    """Rods at these arc lengths, and the derivatives (…, 12) there."""

    def one(parameters: Float[Array, "12"], arc_length: Float[Array, ""]) -> tuple[End, End]:
        def end(parameters: Float[Array, "12"]) -> tuple[End, End]:
            value = _end(parameters, arc_length)
            return value, value

        slopes, value = jax.jacfwd(end, has_aux=True)(parameters)
        return value, slopes

    return jax.vmap(one)(jnp.asarray(parameters), jnp.asarray(arc_length))


def _end(parameters: Float[Array, "12"], arc_length: Float[Array, ""]) -> End:
    load = parameters[LOAD]
    step = arc_length / STEPS
    axes = jnp.eye(3)
    start = (jnp.zeros(3), axes[2], axes[0], -parameters[3:6])

    def slope(s: Array, state: tuple[Array, ...]) -> tuple[Array, ...]:
        _, t, d, m = state
        force = -parameters[:3] - load * s
        rest = parameters[CURVATURE][0] * d + parameters[CURVATURE][1] * jnp.cross(t, d)
        bend = m / (1 - parameters[TAPER] * s) ** 4 + jnp.cross(t, rest)
        return t, jnp.cross(bend, t), jnp.cross(bend, d), -jnp.cross(t, force)

    def moved(
        state: tuple[Array, ...], slopes: tuple[Array, ...], by: Array | float
    ) -> tuple[Array, ...]:
        return tuple(value + by * change for value, change in zip(state, slopes, strict=True))

    def advance(index: Array | int, state: tuple[Array, ...]) -> tuple[Array, ...]:
        s = index * step
        first = slope(s, state)
        second = slope(s + step / 2, moved(state, first, step / 2))
        third = slope(s + step / 2, moved(state, second, step / 2))
        fourth = slope(s + step, moved(state, third, step))
        total = tuple(
            a + 2 * b + 2 * c + d for a, b, c, d in zip(first, second, third, fourth, strict=True)
        )
        return moved(state, total, step / 6)

    reach, tangent, _, moment = lax.fori_loop(0, STEPS, advance, start)
    # What hangs over beyond the contact weighs on it.
    over = 1 - arc_length
    moment = moment - over**2 / 2 * jnp.cross(tangent, load)
    return End(moment, -parameters[:3] - load, tangent, reach)
