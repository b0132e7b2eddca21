"""The inverse map of measured reactions: from f0, m0 and the clamp's tangent alone to the contact
(paper, section II, eqs. 14-16; mechanics.md).

One contact force carries no couple, so r = (m0 × F)/f² − I₁ n̂ with F = −f0: the first term is the
wrench's central axis, and only I₁, how far along it, needs the rod. Everything is dimensionless.
"""

import jax.numpy as jnp

from vibrissa.inverse.arrays import Scalar, Spread, Wrench
from vibrissa.mechanics.elastica import Elastica

invert = Elastica().contact
"""The contact that explains support reactions, by the rod's model."""


def towards(
    start: Wrench,
    at: Wrench,
    value: Scalar,
    slope: Wrench,
    covariance: Spread,
) -> tuple[Wrench, Scalar]:
    """A Gauss–Newton step to the most probable wrench that fulfils a condition: the least change of
    the measured one, `start`, in the metric of its covariance, with the condition's value and slope
    at a wrench; and the size of the change in standard deviations.
    """
    spread = covariance @ slope
    variance = slope @ spread
    missing = value + slope @ (start - at)
    return start - spread * missing / variance, missing / jnp.sqrt(variance)


def single_contact(wrench: Wrench, covariance: Spread) -> tuple[Wrench, Scalar]:
    """Most probable wrench of a single contact, and by how many standard deviations the measured
    one violates its condition m0·f0 = 0 (mechanics.md, "Statics alone"); two steps.
    """

    def step(at: Wrench) -> tuple[Wrench, Scalar]:
        return towards(wrench, at, jnp.dot(at[:3], at[3:]), jnp.roll(at, 3), covariance)

    once, deviation = step(wrench)
    return step(once)[0], deviation
