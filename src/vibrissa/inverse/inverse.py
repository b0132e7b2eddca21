"""The inverse map of measured reactions: from f0, m0 and the clamp's tangent alone to the contact
(paper, section II, eqs. 14-16; mechanics.md).

One contact force carries no couple, so r = (m0 × F)/f² − I₁ n̂ with F = −f0: the first term is the
wrench's central axis, and only I₁, how far along it, needs the rod. Everything is dimensionless.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from vibrissa.mechanics.elastica import base_plane, bending_energy, contact_on_rod

Scalar = Float[Array, ""]
Vector = Float[Array, "3"]

_LARGEST_MODULUS = 1 - 1e-12


class Contact(NamedTuple):
    """Contact seen from the clamp, model units."""

    reach: Vector
    """r = P1 − P0 [L]."""
    direction: Vector
    """n̂ = −f0/f, unit vector of the contact force on the rod; the object's outward normal without
    friction (paper, eq. 15).
    """
    arc_length: Scalar
    modulus: Scalar
    """k²: ½ where the rod is tangent to the object (without friction), at least 1 where the
    curvature has no zero.
    """
    energy: Scalar


def invert(force: Vector, moment: Vector, tangent: Vector) -> Contact:
    """First zero of the curvature from support reactions (on the rod, moment about the clamp) and
    the unit tangent at the clamp.
    """
    F = -force
    f = jnp.sqrt(jnp.sum(F * F))
    n = F / f
    # t' = t0 × m0 at the clamp: the rod bends towards it, with κ₀ = f ℓ.
    plane = base_plane(n, jnp.cross(tangent, moment) / f, tangent)
    # Noise may leave no zero of the curvature; the value then is that of the last wrench which has
    # one, and `modulus` tells.
    modulus = plane.sin_a0**2 + f * plane.lever_arm**2 / 4
    held = jnp.where(modulus < _LARGEST_MODULUS, 1.0, jnp.sqrt(_LARGEST_MODULUS / modulus))
    plane = plane._replace(sin_a0=plane.sin_a0 * held, lever_arm=plane.lever_arm * held)
    rod = contact_on_rod(plane, f)
    reach = jnp.cross(moment, F) / (f * f) - rod.advance * n
    return Contact(reach, n, rod.arc_length, modulus, bending_energy(rod, f))


def single_contact(
    wrench: Float[Array, "6"], covariance: Float[Array, "6 6"]
) -> tuple[Float[Array, "6"], Scalar]:
    """Most probable wrench of a single contact, and by how many standard deviations the measured
    one violates its condition.

    One contact force makes m0·f0 = 0 (mechanics.md, "Statics alone"). The measured (f0, m0) is
    moved there by the least change in the metric of its covariance: two Gauss–Newton steps.
    """
    start = wrench
    deviation = jnp.zeros(())
    for iteration in range(2):
        force, moment = wrench[:3], wrench[3:]
        condition = jnp.dot(force, moment)
        gradient = jnp.concatenate([moment, force])
        spread = covariance @ gradient
        variance = gradient @ spread
        if iteration == 0:
            deviation = condition / jnp.sqrt(variance)
        wrench = start - spread * (condition + gradient @ (start - wrench)) / variance
    return wrench, deviation
