"""The forward problem as a root of the inverse map (mechanics.md, "Contact conditions").

Unknown are the contact point p on the object and the magnitude f of the contact force F = f n(p), x
= (p, f). Everything is dimensionless: lengths in L, forces in EI/L². The line of the force fixes
the lever arm, and with it the whole rod; four conditions are left:

    g(p) = 0                              the point lies on the object, (p − P0) · (t0 × n) = 0
    the rod stays in the plane of t0 and n, (p − P0) · n + I₁ = 0                 the rod reaches
    the point, min(1 − s₁, ½ − k²) = 0               tip contact, or the rod tangent to the object:
    no phase logic.

Where the force acts along the clamp's axis, n = −t0, any plane through the axis will do, and the
second condition is empty: on a flat face across the rod all the way. The bending plane is then the
one that the rod had when it came there, as no force turns it.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Shaped

from vibrissa.mechanics.elastica import BasePlane, ContactOnRod, base_plane, contact_on_rod
from vibrissa.numerics.blocks import ONE_BY_ONE, SIZES, WIDE, in_blocks
from vibrissa.numerics.compiled import operation_count
from vibrissa.numerics.linear import solve_4x4
from vibrissa.surfaces import Surface

Unknowns = Float[Array, "4"]
Vector = Float[Array, "3"]
Scalar = Float[Array, ""]


class Scene(NamedTuple):
    """The object, the rod's length, which turns its units into the model's, and the coefficient of
    friction between them.
    """

    surface: Surface
    length: Float[Array, ""] | float
    friction: Float[Array, ""] | float = 0.0

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of blocks for which kernels are compiled."""
        return ONE_BY_ONE if self.surface.heavy else SIZES

    def in_blocks(
        self,
        kernel: Callable[..., Array],
        *rows: Shaped[np.ndarray, "count ..."],
        width: int = WIDE,
    ) -> Float[np.ndarray, "count ..."]:
        """Apply a compiled kernel of the scene and of blocks (blocks, …, width) to rows (count, …)."""
        return in_blocks(lambda *parts: kernel(self, *parts), *rows, width=width, sizes=self.sizes)


class Clamp(NamedTuple):
    """Clamp point [L] and unit tangent of the rod there."""

    point: Vector
    tangent: Vector


class ContactState(NamedTuple):
    """Everything the unknowns imply at one clamp pose."""

    residual: Float[Array, "4"]
    gap: Scalar
    """First-order distance of the contact point from the object [L]."""
    normal: Vector
    steepness: Scalar
    """‖∇g‖ at the contact."""
    to_contact: Vector
    """r = p − P0 [L]."""
    plane: BasePlane
    rod: ContactOnRod


def level(scene: Scene, point: Vector) -> Scalar:
    """Level function of the object in model units."""
    return scene.surface.level(point * scene.length) / scene.length


def part_levels(scene: Scene, point: Vector) -> Float[Array, "parts"]:
    """Level functions of the object's parts in model units."""
    return scene.surface.part_levels(point * scene.length) / scene.length


# A level function of few operations is written out point by point, which runs as one loop over the
# lanes; of more, it would take long to compile.
_LIGHT = 30


def levels(scene: Scene, points: list[Vector]) -> list[Scalar]:
    """Level function at several points."""
    return _at_each(scene, lambda point: level(scene, point), points)


def levels_elsewhere(scene: Scene, points: list[Vector], contact: Vector) -> list[Scalar]:
    """Level function of the parts that the contact is not on, at several points."""
    touched = jnp.argmin(part_levels(scene, contact))

    def elsewhere(point: Vector) -> Scalar:
        levels = part_levels(scene, point)
        return jnp.min(jnp.where(jnp.arange(levels.shape[0]) == touched, jnp.inf, levels))

    return _at_each(scene, elsewhere, points)


def _at_each(scene: Scene, one: Callable[[Vector], Scalar], points: list[Vector]) -> list[Scalar]:
    if scene.surface.heavy:
        values = lax.map(one, jnp.stack(points))
    elif operation_count(one, jnp.zeros(3)) > _LIGHT:
        values = jax.vmap(one)(jnp.stack(points))
    else:
        return [one(point) for point in points]
    return [values[index] for index in range(len(points))]


_TINY = 1e-300


def contact_state(
    scene: Scene, x: Unknowns, clamp: Clamp, inflections: int = 0, reached: Vector | None = None
) -> ContactState:
    """Evaluate the contact conditions, for a rod whose curvature changes its sign that often
    between clamp and contact.

    `reached` is r of the state before, in whose bending plane a force along the clamp's axis leaves
    the rod; without it, the plane of x itself.
    """
    value, gradient = jax.value_and_grad(level, argnums=1)(scene, x[:3])
    steepness = jnp.sqrt(jnp.sum(gradient * gradient))
    n = gradient / steepness
    bent = bent_by(n, x, clamp, inflections, reached)
    gap = value / lax.stop_gradient(steepness)
    phase = jnp.minimum(1 - bent.rod.arc_length, 0.5 - bent.rod.modulus)
    residual = jnp.stack([gap, bent.out_of_plane, bent.misses, phase])
    return ContactState(residual, gap, n, steepness, bent.to_contact, bent.plane, bent.rod)


NEUTRAL = 1e-6
"""Sine between force and clamp axis up to which they count as parallel: above the rounding of a
face's coordinates in single precision, below any tilt that is meant.
"""


def is_neutral(direction: Vector, tangent: Vector) -> Bool[Array, ""]:
    """Whether a force acts along the clamp's axis, so that it fixes no bending plane."""
    return jnp.sum(jnp.cross(tangent, direction) ** 2) < NEUTRAL**2


def _out_of_plane(r: Vector, direction: Vector, tangent: Vector, reached: Vector | None) -> Scalar:
    """How far the contact lies out of the plane of force and clamp axis; where those are parallel,
    out of the plane of what was reached before.
    """
    across = jnp.cross(tangent, lax.stop_gradient(r) if reached is None else reached)
    held = across / jnp.sqrt(jnp.maximum(jnp.sum(across * across), _TINY))
    return jnp.dot(
        r, jnp.where(is_neutral(direction, tangent), held, jnp.cross(tangent, direction))
    )


class Bent(NamedTuple):
    """A rod under a force of given direction at a point."""

    to_contact: Vector
    plane: BasePlane
    rod: ContactOnRod
    out_of_plane: Scalar
    misses: Scalar
    """How far along the force the rod is from the point [L]."""


def bent_by(
    direction: Vector,
    x: Unknowns,
    clamp: Clamp,
    inflections: int = 0,
    reached: Vector | None = None,
) -> Bent:
    """The inverse map for a force x[3] of a direction at a point x[:3]; the point is on the rod
    where the last two are zero.
    """
    r = x[:3] - clamp.point
    side = direction * jnp.dot(r, clamp.tangent) - r * jnp.dot(direction, clamp.tangent)
    plane = base_plane(direction, side, clamp.tangent)
    rod = contact_on_rod(plane, x[3], inflections)
    return Bent(
        r,
        plane,
        rod,
        _out_of_plane(r, direction, clamp.tangent, reached),
        jnp.dot(r, direction) + rod.advance,
    )


def phase_difference(rod: ContactOnRod) -> Scalar:
    """(1 − s₁) − (½ − k²): negative in tip contact, positive in tangential contact, zero where one
    turns into the other.
    """
    return (1 - rod.arc_length) - (0.5 - rod.modulus)


class NewtonStep(NamedTuple):
    """One step of Newton's method from x."""

    x: Unknowns
    residual: Scalar
    """Largest residual before the step."""
    determinant: Scalar
    """Of the Jacobian before the step: its sign changes where an equilibrium gains or loses
    stability.
    """
    phase: Scalar
    """`phase_difference` before the step."""


_LONGEST_STEP = 0.3
# A step that is as long as this [L] from where the conditions are met already to `_MET` comes of a
# singular Jacobian: it would lead away.
_MET, _ASTRAY = 1e-9, 1e-5


def newton_step(
    scene: Scene, x: Unknowns, clamp: Clamp, inflections: int = 0, reached: Vector | None = None
) -> NewtonStep:
    """Semi-smooth Newton step; the contact point moves by at most 0.3 L."""

    def conditions(x: Unknowns) -> tuple[Float[Array, "4"], tuple[Float[Array, "4"], Scalar]]:
        state = contact_state(scene, x, clamp, inflections, reached)
        return state.residual, (state.residual, phase_difference(state.rod))

    jacobian, (residual, phase) = jax.jacfwd(conditions, has_aux=True)(x)
    step, determinant = solve_4x4(jacobian, residual)
    distance = jnp.sqrt(jnp.sum(step[:3] ** 2))
    shortened = jnp.minimum(1.0, _LONGEST_STEP / jnp.maximum(distance, _LONGEST_STEP))
    largest = jnp.max(jnp.abs(residual))
    there = (largest <= _MET) & ~(distance < _ASTRAY)
    return NewtonStep(jnp.where(there, x, x - shortened * step), largest, determinant, phase)
