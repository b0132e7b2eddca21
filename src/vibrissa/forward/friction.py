"""Contact with Coulomb friction, quasi-static (mechanics.md, "Friction, quasi-static").

The contact force is F = f d with d along n + τ: n the object's normal, τ ⟂ n the tangential force
in units of the normal one, |τ| ≤ μ. The elastica stays plane, in the plane of t0 and d. Four
conditions are those without friction, with d in place of n and the phase with the normal itself,
min(1 − s₁, −t(s₁)·n / 2) = 0. Three more are Coulomb's law for the step of the rod's material point
over the object, w = ΔP₁ − t Δs₁:

    τ = Π_μ(τ − c w),    Π_μ the projection onto the disk of radius μ in the tangent plane,

which is w = 0 inside the cone (sticking, or rolling where the contact also moves along the rod) and
τ = −μ w/|w| on it, without regularisation and for any c > 0 (Alart and Curnier, 1991). The step is
implicit; its tangent t is the mean of both ends.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from vibrissa.forward.equations import Clamp, Scene, bent_by, level
from vibrissa.mechanics.elastic_line import contact_tangent
from vibrissa.mechanics.elastica import BasePlane, ContactOnRod
from vibrissa.numerics.linear import solve_pivoted

Vector = Float[Array, "3"]
Scalar = Float[Array, ""]

UNKNOWNS = 7
"""P, f and τ."""
SIZE = 11
"""What one position hands on to the next: the unknowns, s₁ and the tangent at the contact."""

_AUGMENTATION = 10.0
_LONGEST_STEP = 0.3
_TINY = 1e-300


class RubbingState(NamedTuple):
    """Everything that p, f and τ imply at a clamp pose."""

    conditions: Float[Array, "4"]
    normal: Vector
    steepness: Scalar
    """‖∇g‖ at the contact."""
    direction: Vector
    """d, unit vector of the contact force on the rod."""
    to_contact: Vector
    side: Vector
    """Unit vector from the clamp to the line of the force."""
    tangent: Vector
    """Of the rod at the contact."""
    plane: BasePlane
    rod: ContactOnRod
    phase: Scalar
    """(1 − s₁) + t·n / 2: negative in tip contact, positive in tangential contact."""


class Rub(NamedTuple):
    """One step of Newton's method for a position, given the one before."""

    x: Float[Array, "11"]
    residual: Scalar
    """Largest residual before the step."""
    beyond: Scalar
    """|τ − c w| − μ before the step: negative where the rod sticks or rolls."""
    phase: Scalar


def rubbing_state(scene: Scene, y: Float[Array, "7"], clamp: Clamp) -> RubbingState:
    """Evaluate the rod and the conditions that need no history."""
    tau = y[4:7]
    value, gradient = jax.value_and_grad(level, argnums=1)(scene, y[:3])
    steepness = jnp.sqrt(jnp.sum(gradient * gradient))
    n = gradient / steepness
    leaning = n + tau
    d = leaning / jnp.sqrt(jnp.sum(leaning * leaning))
    r, plane, rod, out_of_plane, misses = bent_by(d, y[:4], clamp)
    side = (r - jnp.dot(r, d) * d) / plane.lever_arm
    tangent = contact_tangent(d, side, rod)
    away = -jnp.dot(tangent, n) / 2
    conditions = jnp.stack(
        [
            value / lax.stop_gradient(steepness),
            out_of_plane,
            misses,
            jnp.minimum(1 - rod.arc_length, away),
        ]
    )
    return RubbingState(
        conditions, n, steepness, d, r, side, tangent, plane, rod, (1 - rod.arc_length) - away
    )


def rub(scene: Scene, y: Float[Array, "7"], clamp: Clamp, before: Float[Array, "11"]) -> Rub:
    """Semi-smooth Newton step; the contact point moves by at most 0.3 L."""

    def conditions(
        y: Float[Array, "7"],
    ) -> tuple[Float[Array, "7"], tuple[Float[Array, "7"], Float[Array, "4"], Scalar, Scalar]]:
        state = rubbing_state(scene, y, clamp)
        law, beyond = _coulomb(scene, y, state, before)
        residual = jnp.concatenate([state.conditions, law])
        return residual, (
            residual,
            jnp.concatenate([state.rod.arc_length[None], state.tangent]),
            beyond,
            state.phase,
        )

    jacobian, (residual, handed_on, beyond, phase) = jax.jacfwd(conditions, has_aux=True)(y)
    step = solve_pivoted(jacobian, residual)
    distance = jnp.sqrt(jnp.sum(step[:3] ** 2))
    shortened = jnp.minimum(1.0, _LONGEST_STEP / jnp.maximum(distance, _LONGEST_STEP))
    return Rub(
        jnp.concatenate([y - shortened * step, handed_on]),
        jnp.max(jnp.abs(residual)),
        beyond,
        phase,
    )


def outside_cone(scene: Scene, tau: Vector, normal: Vector) -> Scalar:
    """By how much a tangential force, in units of the normal one, is outside the friction cone or
    out of the tangent plane.
    """
    return jnp.maximum(jnp.sqrt(jnp.sum(tau * tau)) - scene.friction, 0.0) + jnp.abs(
        jnp.dot(tau, normal)
    )


def sliding(y: Float[Array, "7"], state: RubbingState, before: Float[Array, "11"]) -> Vector:
    """Step w of the rod's material point over the object since the position before, in the tangent
    plane.
    """
    s1, t = before[7], before[8:11]
    w = y[:3] - before[:3] - (state.tangent + t) / 2 * (state.rod.arc_length - s1)
    return w - jnp.dot(w, state.normal) * state.normal


def _coulomb(
    scene: Scene, y: Float[Array, "7"], state: RubbingState, before: Float[Array, "11"]
) -> tuple[Vector, Scalar]:
    """Residual of τ − Π(τ − c w), and by how much the argument of the projection lies outside the
    disk.
    """
    n, tau = state.normal, y[4:7]
    out_of_plane = jnp.dot(tau, n) * n
    w = _AUGMENTATION * sliding(y, state, before)
    trial = tau - out_of_plane - w
    size = jnp.sqrt(jnp.sum(trial * trial) + _TINY)
    sticks = size <= scene.friction
    return jnp.where(
        sticks, out_of_plane + w, tau - scene.friction / size * trial
    ), size - scene.friction
