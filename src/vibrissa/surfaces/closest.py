"""Closest point of a smooth surface and signed distance from it, from the level function alone.

The closest point q to p is where p − q is along the normal: q + λ ∇g(q) = p, g(q) = 0. Newton's
method finds (q, λ); derivatives are those of the equations, not of the iterations. As ∇d = n(q),
second derivatives of the distance take no more than second derivatives of the level function.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

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


class _Plane(NamedTuple):
    """The plane that touches the surface at the foot."""

    distance: Scalar
    """Of the point from it."""
    normal: Vector
    steepness: Scalar
    """‖∇g‖."""
    where: Vector


@eqx.filter_custom_jvp
def distance(solid: Solid, point: Vector) -> Scalar:
    """Signed distance; g/‖∇g‖ where Newton's method does not converge: far away, or inside beyond
    the centres of curvature.
    """
    return _tangent_plane(solid, point).distance


@distance.def_jvp  # type: ignore[untyped-decorator]
def _distance_jvp(primals: tuple[Solid, Vector], tangents: tuple[Any, Any]) -> tuple[Scalar, Any]:
    """Derivatives n(q) along the point and, along the parameters of g, ∂g/‖∇g‖ at q."""
    (solid, point), (solid_change, point_change) = primals, tangents
    plane = _tangent_plane(solid, point)
    change = _pushed(lambda other: other.level(plane.where), solid, solid_change) / plane.steepness
    if point_change is not None:
        change += jnp.dot(plane.normal, point_change)
    return plane.distance, change


def _pushed(function: Callable[[Solid], Array], solid: Solid, change: Any) -> Array:
    """Derivative of a function of the solid along a change of it; None stands for no change."""
    if not jax.tree.leaves(change):
        return jnp.zeros(())
    whole = jax.tree.map(
        lambda moved, part: jnp.zeros_like(part) if moved is None else moved,
        change,
        solid,
        is_leaf=lambda moved: moved is None,
    )
    return jax.jvp(function, (solid,), (whole,))[1]


def _tangent_plane(solid: Solid, point: Vector) -> _Plane:
    """The plane at the closest point; where Newton's method finds none, that of one step from the
    point with its slope taken as constant.
    """
    foot = _foot(solid, point)
    q = foot[:3]
    value, gradient = jax.value_and_grad(solid.level)(q)
    steepness = norm(*gradient)
    normal = gradient / steepness
    found = _Plane(jnp.dot(point - q, normal), normal, steepness, q)
    miss = norm(*(q + foot[3] * gradient - point)) + jnp.abs(value) / steepness

    here = lax.stop_gradient(point)
    value, gradient = lax.stop_gradient(jax.value_and_grad(solid.level)(here))
    steepness = _or_one(norm(*gradient))
    normal = gradient / steepness
    far = _Plane(value / steepness + jnp.dot(normal, point - here), normal, steepness, here)

    rounding = _MISSED_SIZE * norm(*here)
    same_side = (found.distance * value >= 0) | (jnp.abs(found.distance) <= rounding)
    arrived = (miss <= _MISSED * jnp.abs(far.distance) + rounding) & same_side
    return jax.tree.map(lambda one, other: jnp.where(arrived, one, other), found, far)


@eqx.filter_custom_jvp
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
        step, _determinant = solve_4x4(*reversed(_linearised(solid, point, foot)))
        shortened = jnp.minimum(1.0, reach / _or_one(norm(*step[:3])))
        step *= jnp.where(iteration < _HALVED, 1.0, 0.5) * shortened
        # Where the Jacobian is singular, it ends.
        step = jnp.where(jnp.all(jnp.isfinite(step)), step, 0.0)
        return iteration + 1, foot - step, norm(*step[:3])

    start = jnp.append(point - multiplier * gradient, multiplier)
    return lax.while_loop(
        unsettled, refine, (jnp.zeros((), dtype=int), start, jnp.full((), jnp.inf))
    )[1]


@_foot.def_jvp  # type: ignore[untyped-decorator]
def _foot_jvp(primals: tuple[Solid, Vector], tangents: tuple[Any, Any]) -> tuple[Foot, Foot]:
    """The linearised equations at the solution."""
    (solid, point), (solid_change, point_change) = primals, tangents
    foot = _foot(solid, point)
    _, jacobian = _linearised(solid, point, foot)
    right = -_pushed(
        lambda other: _conditions(point, foot, *jax.value_and_grad(other.level)(foot[:3])),
        solid,
        solid_change,
    )
    if point_change is not None:
        right += jnp.append(point_change, 0.0)
    moved, determinant = solve_4x4(jacobian, right)
    return foot, jnp.where(determinant != 0, moved, 0.0)


def _conditions(point: Vector, foot: Foot, value: Scalar, gradient: Vector) -> Foot:
    return jnp.append(foot[:3] + foot[3] * gradient - point, value)


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
