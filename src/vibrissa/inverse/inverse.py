"""The inverse map of measured reactions: from f0, m0 and the clamp's tangent alone to the contact
(paper, section II, eqs. 14-16; mechanics.md).

One contact force carries no couple, so r = (m0 × F)/f² − I₁ n̂ with F = −f0: the first term is the
wrench's central axis, and only I₁, how far along it, needs the rod. Everything is dimensionless.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from vibrissa.mechanics.elastica import Elastica

Scalar = Float[Array, ""]

invert = Elastica().contact
"""The contact that explains support reactions, by the rod's model."""


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
