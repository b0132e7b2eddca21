"""The inverse map: from f0, m0 and the clamp's tangent alone to the contact (paper, section II,
eqs. 14-16; mechanics.md).

A single contact force carries no couple, so r = (m0 × F)/f² − I₁ n̂ with F = −f0: the first term is
the wrench's central axis; only I₁, the distance along it, depends on the rod. All is dimensionless.
"""

import jax.numpy as jnp

from vibrissa.inverse.arrays import Scalar, Spread, Wrench


def towards(
    start: Wrench,
    at: Wrench,
    value: Scalar,
    slope: Wrench,
    covariance: Spread,
) -> tuple[Wrench, Scalar]:
    """One Gauss–Newton step to the most probable wrench that meets a condition: the smallest change
    of the measured wrench `start` in the metric of its covariance, given the condition's value and
    slope `at` a wrench. Also the size of that change in standard deviations.
    """
    spread = covariance @ slope
    variance = slope @ spread
    missing = value + slope @ (start - at)
    return start - spread * missing / variance, missing / jnp.sqrt(variance)


def single_contact(wrench: Wrench, covariance: Spread) -> tuple[Wrench, Scalar]:
    """Most probable wrench of a single contact, in two steps, and by how many standard deviations
    the measured one violates the condition m0·f0 = 0 (mechanics.md, "Statics gives a line").
    """

    def step(at: Wrench) -> tuple[Wrench, Scalar]:
        return towards(wrench, at, jnp.dot(at[:3], at[3:]), jnp.roll(at, 3), covariance)

    once, deviation = step(wrench)
    return step(once)[0], deviation
