"""Closest point of a smooth surface and signed distance from it, from the level function alone.

At the point q closest to p, p − q is along the normal: q + λ ∇g(q) = p, g(q) = 0. Newton's method
finds (q, λ); derivatives are those of the equations, not of the iterations. As ∇d = n(q), second
derivatives of the distance need only second derivatives of the level function.

Level functions are methods of surfaces; the distance can also be differentiated with respect to the
surfaces' parameters.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
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
Level: TypeAlias = Callable[[Vector], Scalar]
Arguments: TypeAlias = tuple[Level, Vector]

_REACH = 2.0
"""Longest step, as a multiple of the first-order distance."""
_MOST_ITERATIONS = 60
# Iteration from which steps are halved: where Newton's method oscillates, half a step gains ground.
_HALVED = 12
# Step, relative to the longest one and to the point's norm, after which another would change
# nothing.
_SETTLED, _SETTLED_SIZE = 1e-9, 1e-15
# Largest residual of the equations, in much the same terms.
_MISSED, _MISSED_SIZE = 1e-6, 1e-12


class _Measured(NamedTuple):
    """Signed distance from the tangent plane of the level surface through a point."""

    distance: Scalar
    normal: Vector
    steepness: Scalar
    where: Vector


@eqx.filter_custom_jvp
def distance(level: Level, point: Vector) -> Scalar:
    """Signed distance; g/‖∇g‖ where Newton's method does not converge: far away, or inside beyond
    the centres of curvature.
    """
    return _measured(level, point).distance


def _distance_jvp(primals: Arguments, tangents: Any) -> tuple[Scalar, Scalar]:
    """Derivatives: n(q) by the point and, by the parameters of g, ∂g/‖∇g‖ at q."""
    measured = _measured(*primals)

    def linearised(level: Level, point: Vector) -> Scalar:
        return level(measured.where) / measured.steepness + jnp.dot(measured.normal, point)

    return measured.distance, eqx.filter_jvp(linearised, primals, tangents)[1]


distance.def_jvp(_distance_jvp)  # type: ignore[no-untyped-call]


def _measured(level: Level, point: Vector) -> _Measured:
    """From the tangent plane at the foot; if that is not a foot, by one step from the point, its
    gradient taken as constant.
    """
    foot = _foot(level, point)
    near = _from_plane(level, foot[:3], point)
    here = lax.stop_gradient(point)
    far = _from_plane(lax.stop_gradient(level), here, point)
    off = point - near.where
    miss = norm(*(off - foot[3] * near.steepness * near.normal))
    miss += jnp.abs(near.distance - jnp.dot(near.normal, off))
    rounding = _MISSED_SIZE * norm(*here)
    same_side = (near.distance * far.distance >= 0) | (jnp.abs(near.distance) <= rounding)
    arrived = (miss <= _MISSED * jnp.abs(far.distance) + rounding) & same_side
    return jax.tree.map(partial(jnp.where, arrived), near, far)


def _from_plane(level: Level, where: Vector, point: Vector) -> _Measured:
    value, gradient = jax.value_and_grad(level)(where)
    steepness = _or_one(norm(*gradient))
    normal = gradient / steepness
    return _Measured(value / steepness + jnp.dot(normal, point - where), normal, steepness, where)


@eqx.filter_custom_jvp
def _foot(level: Level, point: Vector) -> Foot:
    """Newton's method, started with the first-order step, its steps limited in length."""
    value, gradient = jax.value_and_grad(level)(point)
    multiplier = value / _or_one(jnp.sum(gradient * gradient))
    reach = _REACH * jnp.abs(multiplier) * norm(*gradient)
    settled = _SETTLED * reach + _SETTLED_SIZE * norm(*point)

    def unsettled(state: tuple[Array, Foot, Scalar]) -> Array:
        return (state[0] < _MOST_ITERATIONS) & (state[2] > settled)

    def refine(state: tuple[Array, Foot, Scalar]) -> tuple[Array, Foot, Scalar]:
        iteration, foot, _ = state
        missed, jacobian = _linearised(level, point, foot)
        step, _ = solve_4x4(jacobian, missed)
        step *= jnp.where(iteration < _HALVED, 1.0, 0.5)
        step *= jnp.minimum(1.0, reach / _or_one(norm(*step[:3])))
        step = jnp.where(jnp.all(jnp.isfinite(step)), step, 0.0)
        return iteration + 1, foot - step, norm(*step[:3])

    start = jnp.append(point - multiplier * gradient, multiplier)
    return lax.while_loop(unsettled, refine, (jnp.array(0), start, jnp.array(jnp.inf)))[1]


def _foot_jvp(primals: Arguments, tangents: Any) -> tuple[Foot, Foot]:
    """The linearised equations at the solution."""
    foot = _foot(*primals)

    def missed(level: Level, point: Vector) -> Foot:
        return _missed(point, foot, *jax.value_and_grad(level)(foot[:3]))

    _, jacobian = _linearised(*primals, foot)
    moved, determinant = solve_4x4(jacobian, -eqx.filter_jvp(missed, primals, tangents)[1])
    return foot, jnp.where(determinant != 0, moved, 0.0)


_foot.def_jvp(_foot_jvp)  # type: ignore[no-untyped-call]


def _missed(point: Vector, foot: Foot, value: Scalar, gradient: Vector) -> Foot:
    return jnp.append(foot[:3] + foot[3] * gradient - point, value)


def _linearised(level: Level, point: Vector, foot: Foot) -> tuple[Foot, Float[Array, "4 4"]]:
    """Residual of the equations, and its Jacobian with respect to (q, λ)."""

    def slope(q: Vector) -> tuple[Vector, tuple[Scalar, Vector]]:
        value, gradient = jax.value_and_grad(level)(q)
        return gradient, (value, gradient)

    hessian, (value, gradient) = jax.jacfwd(slope, has_aux=True)(foot[:3])
    curved = jnp.eye(3) + foot[3] * hessian
    jacobian = jnp.block([[curved, gradient[:, None]], [gradient, jnp.zeros(())]])
    return _missed(point, foot, value, gradient), jacobian


def _or_one(x: Scalar) -> Scalar:
    return jnp.where(x > 0, x, 1.0)
