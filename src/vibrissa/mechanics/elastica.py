"""Uniform straight rod under one contact force: the inverse map in closed form (mechanics.md, "The
uniform rod in closed form").

In the plane of the clamp tangent t0 and the contact force F let θ(s) be the angle of the tangent
from t0 towards the side b to which the rod bends, δ the angle of F = f n̂, and a = (θ + π − δ)/2.
Then θ'' = f sin(θ − δ) (paper, eq. 10), a' = √f √(k² − sin² a), and the contact is the first zero
of the curvature, sin a = k. With ℓ = κ₀/f the lever arm and w = f ℓ²/4, everything follows from sin
a₀ and w:

    k² = sin² a₀ + w,   s₁ = ℓ σ(sin a₀, w),   I₁ = ℓ ι(sin a₀, w),   r = r_⊥ − I₁ n̂,   |r_⊥| = ℓ.

Legendre's integrals are taken at half the argument: sin² β = sin(α − a₀) / (sin α (cos a₀ + cos α))
with sin α = k, F(χ') = 2 F(β). That keeps β below 90° where the force passes behind the clamp axis
(a₀ < 0), and has no square-root singularity at first contact, f → 0, where w may even turn
negative.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.mechanics.model import (
    Bent,
    Clamp,
    Contact,
    Own,
    Resting,
    RodModel,
    Straight,
    is_neutral,
)
from vibrissa.numerics.carlson import carlson_rf_rd
from vibrissa.numerics.trigonometry import cosine, sine
from vibrissa.numerics.vectors import dot, joined

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]

_MEANS = 6
"""Steps of the arithmetic-geometric mean: it converges quadratically, so these reach the last digit
for every k² below 1 − 1e-12.
"""
_NODE_COUNT = 14
"""Chebyshev nodes along the bent part: its points are exact to 1e-8 for k² ≤ ½."""
_LEAST_FORCE = 1e-12
"""Least force [EI/L²] under which a line is drawn: it is straight to 1e-12 L."""
_LARGEST_MODULUS = 1 - 1e-12
"""k² up to which the curvature is taken to have a zero."""
_TINY = 1e-300


class BasePlane(NamedTuple):
    """The geometry in the bending plane at the base: all that the closed form needs besides the
    force's magnitude.
    """

    sin_a0: Scalar
    """Sine of a₀ = (π − δ)/2."""
    lever_arm: Scalar
    """ℓ = κ₀/f, distance of the clamp from the line of the force [L]."""


class ContactOnRod(NamedTuple):
    """Where the first zero of the curvature lies."""

    arc_length: Scalar
    """s₁ [L]."""
    advance: Scalar
    """I₁ [L], advance of the elastic line along −n̂."""
    modulus: Scalar
    """k² of the elliptic integrals; ½ where the rod is tangent to the object."""


def base_plane(direction: Vector, to_contact_side: Vector, tangent: Vector) -> BasePlane:
    """Base angle and lever arm.

    Parameters
    ----------
    direction
        n̂, unit vector of the contact force on the rod.
    to_contact_side
        ℓ b: unit vector b of the side to which the rod bends at its base, times the lever arm [L].
    tangent
        t0, unit tangent of the rod at the clamp.
    """
    lever_arm = jnp.sqrt(jnp.sum(to_contact_side**2))
    sin_delta = dot(direction, to_contact_side) / lever_arm
    cos_a0 = jnp.sqrt((1 - dot(direction, tangent)) / 2)
    return BasePlane(sin_delta / (2 * cos_a0), lever_arm)


def contact_on_rod(plane: BasePlane, force: Scalar, inflections: int = 0) -> ContactOnRod:
    """Arc length and advance of a zero of the curvature under a contact force of magnitude `force`
    [EI/L²]: the first, or one after some inflections.

    From one zero to the next, s grows by 2K/√f and the advance by (4E − 2K)/√f.
    """
    w = force * plane.lever_arm**2 / 4
    sigma, iota = unit_lever(plane.sin_a0, w)
    modulus = plane.sin_a0**2 + w
    s1, advance = sigma * plane.lever_arm, iota * plane.lever_arm
    if inflections:
        first, second = complete_integrals(modulus)
        count = inflections / jnp.sqrt(force)
        s1, advance = s1 + 2 * count * first, advance + count * (4 * second - 2 * first)
    return ContactOnRod(s1, advance, modulus)


def complete_integrals(k2: Scalar) -> tuple[Scalar, Scalar]:
    """K(k) and E(k), by the arithmetic-geometric mean (DLMF 19.8.5-6)."""
    a, b, total, weight = jnp.ones_like(k2), jnp.sqrt(1 - k2), k2 / 2, 0.5
    for _ in range(_MEANS):
        a, b, difference = (a + b) / 2, jnp.sqrt(a * b), (a - b) / 2
        weight *= 2
        total = total + weight * difference**2
    first = jnp.pi / (2 * a)
    return first, first * (1 - total)


def bending_energy(contact: ContactOnRod, force: Scalar) -> Scalar:
    """Bending energy [EI/L]: U = f (I₁ − (1 − 2k²) s₁)."""
    return force * (contact.advance - (1 - 2 * contact.modulus) * contact.arc_length)


def largest_curvature(plane: BasePlane, contact: ContactOnRod, force: Scalar) -> Scalar:
    """Largest curvature along the rod [1/L]: κ = 2√f √(k² − sin² a), so f ℓ at the clamp, or 2√f k
    further out where a passes through zero (a₀ < 0).
    """
    inside = 2 * jnp.sqrt(jnp.maximum(force * contact.modulus, 0.0))
    return jnp.where(plane.sin_a0 < 0, inside, force * plane.lever_arm)


class Inner(NamedTuple):
    """What the closed form knows about a bent rod besides what every model provides."""

    plane: BasePlane
    rod: ContactOnRod


class Elastica(RodModel):
    """The uniform straight rod."""

    inflections: int = eqx.field(static=True, default=0)
    """How often the curvature changes sign between clamp and contact."""

    def free(self, clamp: Clamp, resting: Resting | None = None) -> Straight:  # noqa: ARG002
        """As in `RodModel`."""
        return Straight(clamp)

    def bent(
        self,
        clamp: Clamp,
        point: Vector,
        force: Scalar,
        direction: Vector,
        own: Own = (),  # noqa: ARG002
        reached: Vector | None = None,
        near: Scalar | None = None,  # noqa: ARG002
    ) -> Bent:
        """As in `RodModel`; the point may lie out of the rod's plane, and away along the force."""
        r, d, t0 = point - clamp.point, direction, clamp.tangent
        plane = base_plane(d, d * dot(r, t0) - r * dot(d, t0), t0)
        rod = contact_on_rod(plane, force, self.inflections)
        # Where the force acts along the clamp's axis, any plane through the axis will do: the rod
        # stays in the plane it came in, as no force turns it.
        before = jnp.cross(t0, lax.stop_gradient(r) if reached is None else reached)
        held = before / jnp.sqrt(jnp.maximum(jnp.sum(before * before), _TINY))
        out_of_plane = dot(r, jnp.where(is_neutral(d, t0), held, jnp.cross(t0, d)))
        misses = joined(out_of_plane, dot(r, d) + rod.advance)
        return Bent(point, r, force, d, misses, rod.arc_length, rod.modulus, Inner(plane, rod))

    def side(self, bent: Bent) -> Vector:
        """Unit vector from the clamp to the line of the force."""
        r, d = bent.to_contact, bent.direction
        return (r - dot(r, d) * d) / bent.inner.plane.lever_arm

    def tangent(self, bent: Bent) -> Vector:
        """As in `RodModel`; where a = α it makes 2α with −d."""
        return contact_tangent(bent.direction, self.side(bent), bent.incidence)

    def energy(self, bent: Bent) -> Scalar:
        """As in `RodModel`."""
        return bending_energy(bent.inner.rod, bent.force)

    def largest_curvature(self, bent: Bent) -> Scalar:
        """As in `RodModel`."""
        return largest_curvature(bent.inner.plane, bent.inner.rod, bent.force)

    def largest_bend(self, bent: Bent) -> Scalar:
        """As in `RodModel`."""
        return self.largest_curvature(bent)

    def points(self, bent: Bent, share: Float[np.ndarray, "n"]) -> Float[Array, "n 3"]:
        """As in `RodModel`.

        With c = π/2 − χ: ds = dc / (√f √(1 − k² cos² c)), the distance from the line of the force
        is κ/f = 2 k sin c / √f, and the rod advances along −d by (1 − 2 k² cos² c) ds.
        """
        plane, k2 = bent.inner.plane, bent.inner.rod.modulus
        root = jnp.sqrt(jnp.maximum(bent.force, _LEAST_FORCE))
        span = jnp.arctan2(root * plane.lever_arm / 2, plane.sin_a0)
        nodes, integrate = _cumulative_chebyshev(tuple(share.tolist()))
        flexed = k2 * cosine(span * nodes) ** 2
        advance = integrate @ ((1 - 2 * flexed) * lax.rsqrt(1 - flexed) * (span / root))
        distance = 2 * jnp.sqrt(k2) / root * sine(span * share)
        return bent.point + advance[:, None] * bent.direction - distance[:, None] * self.side(bent)

    def tail(self, bent: Bent, share: Float[np.ndarray, "n"]) -> Float[Array, "n 3"]:
        """As in `RodModel`: it is straight."""
        rest = jnp.maximum(1 - bent.arc_length, 0.0) * share[:, None]
        return bent.point + rest * self.tangent(bent)

    def contact(
        self,
        force: Vector,
        moment: Vector,
        clamp: Clamp,
        which: Int[Any, ""] | int = 0,  # noqa: ARG002
    ) -> Contact:
        """As in `RodModel`: r = (m0 × F)/f² − I₁ d with F = −f0 = f d (paper, eqs. 14-16).

        The first term gives the wrench's central axis; only I₁, how far along it, depends on the
        rod. With noise the curvature may have no zero; the value is then that of the last wrench
        that has one, and the incidence shows it.
        """
        F, tangent = -force, clamp.tangent
        f = jnp.sqrt(jnp.sum(F * F))
        d = F / f
        # t' = t0 × m0 at the clamp: the rod bends towards it, with κ₀ = f ℓ.
        plane = base_plane(d, jnp.cross(tangent, moment) / f, tangent)
        modulus = plane.sin_a0**2 + f * plane.lever_arm**2 / 4
        held = jnp.where(modulus < _LARGEST_MODULUS, 1.0, jnp.sqrt(_LARGEST_MODULUS / modulus))
        rod = contact_on_rod(BasePlane(plane.sin_a0 * held, plane.lever_arm * held), f)
        reach = jnp.cross(moment, F) / (f * f) - rod.advance * d
        return Contact(reach, d, rod.arc_length, modulus, bending_energy(rod, f), jnp.zeros(()))


@lru_cache(maxsize=8)
def _cumulative_chebyshev(
    targets: tuple[float, ...],
) -> tuple[Float[np.ndarray, "nodes"], Float[np.ndarray, "targets nodes"]]:
    """Chebyshev–Lobatto nodes on [0, 1], and the matrix that integrates values at the nodes from 0
    to each target.
    """
    nodes = (1 - np.cos(np.pi * np.arange(_NODE_COUNT) / (_NODE_COUNT - 1))) / 2
    chebyshev = np.polynomial.chebyshev
    antiderivatives = chebyshev.chebint(np.eye(_NODE_COUNT), lbnd=-1, axis=0)
    integrals = chebyshev.chebval(2 * np.array(targets) - 1, antiderivatives).T / 2
    return nodes, integrals @ np.linalg.inv(chebyshev.chebvander(2 * nodes - 1, _NODE_COUNT - 1))


def contact_tangent(direction: Vector, side: Vector, incidence: Scalar) -> Vector:
    """Unit tangent at the contact, where a = α: it makes 2α with −d, sin² α = k², towards `side`,
    the unit vector from the clamp to the line of the force.
    """
    k2 = incidence
    return -(1 - 2 * k2) * direction + 2 * jnp.sqrt(jnp.maximum(k2 * (1 - k2), 0.0)) * side


@jax.custom_jvp
def unit_lever(sin_a0: Scalar, w: Scalar) -> tuple[Scalar, Scalar]:
    """σ = s₁/ℓ and ι = I₁/ℓ as functions of sin a₀ and w = f ℓ²/4; NaN where the curvature has no
    zero (k² ≥ 1).
    """
    return _unit_lever(sin_a0, w)


@unit_lever.defjvp
def _unit_lever_jvp(
    primals: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]
) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    # Both partial derivatives once, however many directions Newton asks for.
    values, (sigma, iota) = jax.vmap(
        lambda *direction: jax.jvp(_unit_lever, primals, direction), out_axes=(None, 0)
    )(*jnp.eye(2))
    da, dw = tangents
    return values, (sigma[0] * da + sigma[1] * dw, iota[0] * da + iota[1] * dw)


def _unit_lever(sin_a0: Scalar, w: Scalar) -> tuple[Scalar, Scalar]:
    cos_a0 = jnp.sqrt(1 - sin_a0 * sin_a0)
    k2 = sin_a0 * sin_a0 + w
    k, k_co = jnp.sqrt(k2), jnp.sqrt(1 - k2)
    # sin(α − a₀): written as w / sin(α + a₀) it does not cancel where a₀ > 0, as a difference it
    # does not where a₀ < 0.
    ahead = sin_a0 >= 0
    sum_sine = jnp.where(ahead, k * cos_a0 + k_co * sin_a0, 1.0)
    difference_sine = k * cos_a0 - k_co * sin_a0
    denominator = k * (cos_a0 + k_co)
    X = jnp.where(ahead, w / sum_sine, difference_sine) / denominator
    sin_beta = 0.5 * jnp.sqrt(
        jnp.where(
            ahead,
            1 / (sum_sine * denominator),
            difference_sine / (jnp.where(ahead, 1.0, w) * denominator),
        )
    )
    first, second = legendre_over_sine(X, k2)
    sigma = 2 * sin_beta * first
    iota = 4 * sin_beta * second - (k * X + sin_a0) / cos_a0 - sigma
    return sigma, iota


@jax.custom_jvp
def legendre_over_sine(X: Scalar, k2: Scalar) -> tuple[Scalar, Scalar]:
    """F(β, k)/sin β and E(β, k)/sin β with X = sin² β: analytic through β = 0 (DLMF 19.25.5,
    19.25.9).
    """
    rf, rd, _ = carlson_rf_rd(1 - X, 1 - k2 * X)
    return rf, rf - k2 * X * rd / 3


@legendre_over_sine.defjvp
def _legendre_over_sine_jvp(
    primals: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]
) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    # ∂R_F/∂x = −R_D(y, z, x)/6 (DLMF 19.18.1), and the three R_D add up to 3/√(xyz) (DLMF 19.21.8):
    # nothing cancels at X = 0.
    X, k2 = primals
    x, y = 1 - X, 1 - k2 * X
    rf, rd_z, rd_y = carlson_rf_rd(x, y)
    root = 1 / jnp.sqrt(x * y)
    rd_x = 3 * root - rd_z - rd_y
    slope = (rd_x + k2 * rd_y) / 6
    dX, dk2 = tangents
    first = slope * dX + X * rd_y / 6 * dk2
    second = (slope - k2 / 2 * (root - rd_z / 3)) * dX - X * rd_z / 6 * dk2
    return (rf, rf - k2 * X * rd_z / 3), (first, second)
