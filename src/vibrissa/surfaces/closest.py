"""Closest point of a smooth surface and signed distance from it, from the level function alone.

The closest point q to p is where p − q is along the normal: q + λ ∇g(q) = p, g(q) = 0. Newton's method finds (q, λ); derivatives are those of the equations,
not of the iterations. As ∇d = n(q), second derivatives of the distance take no more than second derivatives of the level function.
"""

from typing import Protocol

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from vibrissa.numerics.linear import solve_4x4
from vibrissa.numerics.norms import norm

Vector = Float[Array, "3"]
Scalar = Float[Array, ""]
Foot = Float[Array, "4"]
"""(q, λ)."""

_ITERATIONS = 10
_RELATIVE, _ROUNDING = 1e-6, 1e-12


class Solid(Protocol):
    """What has a level function."""

    def level(self, point: Vector) -> Scalar:
        """g(p)."""


def distance(solid: Solid, point: Vector) -> Scalar:
    """Signed distance; g/‖∇g‖ where Newton's method does not arrive: far away, or inside beyond the centres of curvature."""
    value, gradient = jax.value_and_grad(solid.level)(point)
    steepness = lax.stop_gradient(norm(gradient))
    first_order = value / jnp.where(steepness > 0, steepness, 1.0)
    found, miss = _distance(solid, point)
    size = _ROUNDING * norm(lax.stop_gradient(point))
    same_side = (found * value >= 0) | (jnp.abs(found) <= size)
    return jnp.where((miss <= _RELATIVE * jnp.abs(first_order) + size) & same_side, found, first_order)


@jax.custom_jvp
def _distance(solid: Solid, point: Vector) -> tuple[Scalar, Scalar]:
    """Distance to the tangent plane at the foot, and by how much [length] the equations are missed there."""
    foot = _foot(solid, point)
    residual = _conditions(solid, point, foot)
    gradient = jax.grad(solid.level)(foot[:3])
    steepness = norm(gradient)
    return jnp.dot(point - foot[:3], gradient) / steepness, norm(residual[:3]) + jnp.abs(residual[3]) / steepness


@_distance.defjvp
def _distance_jvp(primals: tuple[Solid, Vector], tangents: tuple[Solid, Vector]) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    """Derivatives ∇d = n(q) and, along the parameters of g, ∂g/‖∇g‖ at q."""
    (solid, point), (solid_change, point_change) = primals, tangents
    foot = _foot(solid, point)
    q = foot[:3]
    value, gradient = jax.value_and_grad(solid.level)(q)
    steepness = norm(gradient)
    miss = norm(point - q - foot[3] * gradient) + jnp.abs(value) / steepness
    normal = gradient / steepness
    _, level_change = jax.jvp(lambda changed: changed.level(q), (solid,), (solid_change,))
    change = jnp.dot(normal, point_change) + level_change / steepness
    return (jnp.dot(point - q, normal), lax.stop_gradient(miss)), (change, jnp.zeros_like(miss))


@jax.custom_jvp
def _foot(solid: Solid, point: Vector) -> Foot:
    """Newton's method from the first-order step; no step is longer than that one."""
    value, gradient = jax.value_and_grad(solid.level)(point)
    square = jnp.sum(gradient * gradient)
    multiplier = value / jnp.where(square > 0, square, 1.0)
    reach = jnp.abs(multiplier) * norm(gradient)

    def refine(_: Array | int, foot: Foot) -> Foot:
        step, _determinant = solve_4x4(_jacobian(solid, point, foot), _conditions(solid, point, foot))
        longest = norm(step[:3])
        new = foot - step * jnp.minimum(1.0, reach / jnp.where(longest > 0, longest, 1.0))
        return jnp.where(jnp.all(jnp.isfinite(new)), new, foot)

    start = jnp.concatenate([point - multiplier * gradient, multiplier[None]])
    return lax.fori_loop(0, _ITERATIONS, refine, start)


@_foot.defjvp
def _foot_jvp(primals: tuple[Solid, Vector], tangents: tuple[Solid, Vector]) -> tuple[Foot, Foot]:
    """The linearised equations at the solution."""
    solid, point = primals
    foot = _foot(solid, point)
    _, moved = jax.jvp(lambda solid, point: _conditions(solid, point, foot), primals, tangents)
    change, determinant = solve_4x4(_jacobian(solid, point, foot), -moved)
    return foot, jnp.where(determinant != 0, change, 0.0)


def _conditions(solid: Solid, point: Vector, foot: Foot) -> Float[Array, "4"]:
    value, gradient = jax.value_and_grad(solid.level)(foot[:3])
    return jnp.concatenate([foot[:3] + foot[3] * gradient - point, value[None]])


def _jacobian(solid: Solid, point: Vector, foot: Foot) -> Float[Array, "4 4"]:
    return jax.jacfwd(lambda foot: _conditions(solid, point, foot))(foot)
