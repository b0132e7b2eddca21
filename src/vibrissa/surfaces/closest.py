"""Closest point of a smooth surface and signed distance from it, from the level function alone.

The closest point q to p is where p − q is along the normal: q + λ ∇g(q) = p, g(q) = 0. Newton's
method finds (q, λ); derivatives are those of the equations, not of the iterations. As ∇d = n(q),
second derivatives of the distance take no more than second derivatives of the level function.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Float

from vibrissa.numerics.linear import solve_4x4
from vibrissa.numerics.norms import norm

Vector = Float[Array, "3"]
Scalar = Float[Array, ""]
Foot = Float[Array, "4"]
"""(q, λ)."""

_REACH = 2.0
"""Longest step in shares of the first-order distance."""
_MOST_ITERATIONS = 60
# From when on steps are halved: where Newton's method goes to and fro, half of its way leads on.
_HALVED = 12
# A step, in shares of the longest and of the point's own size, after which another would change
# nothing.
_SETTLED, _SETTLED_SIZE = 1e-9, 1e-15
# By how much the equations may be missed, in the same terms.
_MISSED, _MISSED_SIZE = 1e-6, 1e-12


@runtime_checkable
class Solid(Protocol):
    """What has a level function."""

    def level(self, point: Vector) -> Scalar:
        """g(p)."""


class _Measured(NamedTuple):
    distance: Scalar
    normal: Vector
    steepness: Scalar
    where: Vector


@jax.custom_jvp
def distance(solid: Solid, point: Vector) -> Scalar:
    """Signed distance; g/‖∇g‖ where Newton's method does not arrive: far away, or inside beyond the
    centres of curvature.
    """
    return _measured(solid, point).distance


def _distance_jvp(
    primals: tuple[Solid, Vector], tangents: tuple[Solid, Vector | SymbolicZero]
) -> tuple[Scalar, Scalar]:
    """Derivatives n(q) along the point and, along the parameters of g, ∂g/‖∇g‖ at q."""
    (solid, point), (solid_change, point_change) = primals, tangents
    measured = _measured(solid, point)
    change = jnp.zeros_like(measured.distance)
    if not isinstance(point_change, SymbolicZero):
        change += jnp.dot(measured.normal, point_change)
    if not _constant(solid_change):
        _, level_change = jax.jvp(
            lambda changed: changed.level(measured.where), (solid,), (_materialised(solid_change),)
        )
        change += level_change / measured.steepness
    return measured.distance, change


distance.defjvp(_distance_jvp, symbolic_zeros=True)


def _measured(solid: Solid, point: Vector) -> _Measured:
    """Distance from the plane that touches the surface at the foot; where that is none, by one step
    from the point with its slope taken as constant.
    """
    foot = _foot(solid, point)
    q = foot[:3]
    value, gradient = jax.value_and_grad(solid.level)(q)
    steepness = norm(*gradient)
    normal = gradient / steepness
    found = jnp.dot(point - q, normal)
    miss = norm(*(q + foot[3] * gradient - point)) + jnp.abs(value) / steepness

    here = lax.stop_gradient(point)
    value_here, gradient_here = lax.stop_gradient(jax.value_and_grad(solid.level)(here))
    steepness_here = _or_one(norm(*gradient_here))
    normal_here = gradient_here / steepness_here
    first_order = value_here / steepness_here + jnp.dot(normal_here, point - here)

    rounding = _MISSED_SIZE * norm(*here)
    same_side = (found * value_here >= 0) | (jnp.abs(found) <= rounding)
    arrived = (miss <= _MISSED * jnp.abs(first_order) + rounding) & same_side
    near = _Measured(found, normal, steepness, q)
    far = _Measured(first_order, normal_here, steepness_here, here)
    return _Measured(
        *(jnp.where(arrived, one, other) for one, other in zip(near, far, strict=True))
    )


@jax.custom_jvp
def _foot(solid: Solid, point: Vector) -> Foot:
    """Newton's method from the first-order step, its steps limited in length."""
    value, gradient = jax.value_and_grad(solid.level)(point)
    multiplier = value / _or_one(jnp.sum(gradient * gradient))
    reach = _REACH * jnp.abs(multiplier) * norm(*gradient)

    settled = _SETTLED * reach + _SETTLED_SIZE * norm(*point)

    def unsettled(state: tuple[Array, Foot, Scalar]) -> Array:
        return (state[0] < _MOST_ITERATIONS) & (state[2] > settled)

    def refine(state: tuple[Array, Foot, Scalar]) -> tuple[Array, Foot, Scalar]:
        iteration, foot, _ = state
        residual, jacobian = _linearised(solid, point, foot)
        step, _determinant = solve_4x4(jacobian, residual)
        step *= jnp.where(state[0] < _HALVED, 1.0, 0.5) * jnp.minimum(
            1.0, reach / _or_one(norm(*step[:3]))
        )
        finite = jnp.all(jnp.isfinite(step))
        return (
            iteration + 1,
            jnp.where(finite, foot - step, foot),
            jnp.where(finite, norm(*step[:3]), 0.0),
        )

    start = jnp.concatenate([point - multiplier * gradient, multiplier[None]])
    return lax.while_loop(
        unsettled, refine, (jnp.zeros((), dtype=int), start, jnp.full((), jnp.inf))
    )[1]


def _foot_jvp(
    primals: tuple[Solid, Vector], tangents: tuple[Solid, Vector | SymbolicZero]
) -> tuple[Foot, Foot]:
    """The linearised equations at the solution."""
    (solid, point), (solid_change, point_change) = primals, tangents
    foot = _foot(solid, point)
    _, jacobian = _linearised(solid, point, foot)
    right = jnp.zeros_like(foot)
    if not isinstance(point_change, SymbolicZero):
        right += jnp.concatenate([point_change, jnp.zeros(1)])
    if not _constant(solid_change):
        change = (_materialised(solid_change),)
        right -= jax.jvp(
            lambda changed: _conditions(point, foot, *jax.value_and_grad(changed.level)(foot[:3])),
            (solid,),
            change,
        )[1]
    moved, determinant = solve_4x4(jacobian, right)
    return foot, jnp.where(determinant != 0, moved, 0.0)


_foot.defjvp(_foot_jvp, symbolic_zeros=True)


def _conditions(point: Vector, foot: Foot, value: Scalar, gradient: Vector) -> Foot:
    return jnp.concatenate([foot[:3] + foot[3] * gradient - point, value[None]])


def _linearised(solid: Solid, point: Vector, foot: Foot) -> tuple[Foot, Float[Array, "4 4"]]:
    """The conditions and their Jacobian by (q, λ)."""

    def slope(q: Vector) -> tuple[Vector, tuple[Scalar, Vector]]:
        value, gradient = jax.value_and_grad(solid.level)(q)
        return gradient, (value, gradient)

    hessian, (value, gradient) = jax.jacfwd(slope, has_aux=True)(foot[:3])
    upper = jnp.concatenate([jnp.eye(3) + foot[3] * hessian, gradient[:, None]], axis=1)
    return _conditions(point, foot, value, gradient), jnp.concatenate(
        [upper, jnp.append(gradient, 0.0)[None]]
    )


def _or_one(x: Scalar) -> Scalar:
    return jnp.where(x > 0, x, 1.0)


def _is_symbolic(part: object) -> bool:
    return isinstance(part, SymbolicZero)


def _constant(change: object) -> bool:
    return all(map(_is_symbolic, jax.tree.leaves(change, is_leaf=_is_symbolic)))


def _materialised(change: Solid) -> Solid:
    """The same with zeros written out."""
    return jax.tree.map(
        lambda part: jnp.zeros(part.shape, part.dtype) if _is_symbolic(part) else part,
        change,
        is_leaf=_is_symbolic,
    )
