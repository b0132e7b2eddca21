"""The shape of the rod between clamp and contact, and straight on to its tip."""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float
from scipy.special import ellipeinc, ellipj

from vibrissa.mechanics.elastica import BasePlane, ContactOnRod
from vibrissa.numerics.trigonometry import cosine, sine

Scalar = Float[Array, ""]
Vector = Float[Array, "3"]

_NODE_COUNT = 14
BEND_POINTS, FINE_POINTS = 25, 385
_NEAR_STEP, _NEAR_POINTS = 2, 17
_LEAST_FORCE = 1e-12


def _cumulative_chebyshev(
    count: int, points: int
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "points n"]]:
    """Chebyshev–Lobatto nodes on [0, 1], and the matrix that integrates values at the nodes from 0
    to each of equally spaced points.
    """
    nodes = (1 - np.cos(np.pi * np.arange(count) / (count - 1))) / 2
    targets = np.linspace(0, 1, points)
    basis = np.polynomial.chebyshev.chebvander(2 * nodes - 1, count - 1)
    integrals = np.empty((points, count))
    for degree in range(count):
        antiderivative = np.polynomial.chebyshev.chebint(np.eye(count)[degree], lbnd=-1)
        integrals[:, degree] = np.polynomial.chebyshev.chebval(2 * targets - 1, antiderivative) / 2
    return nodes, integrals @ np.linalg.inv(basis)


_NODES, _INTEGRATE = _cumulative_chebyshev(_NODE_COUNT, BEND_POINTS)
_, _INTEGRATE_FINELY = _cumulative_chebyshev(_NODE_COUNT, FINE_POINTS)
_INTEGRATE_NEAR = _INTEGRATE_FINELY[: _NEAR_STEP * _NEAR_POINTS : _NEAR_STEP]


def bent_part(
    plane: BasePlane, rod: ContactOnRod, force: Scalar
) -> tuple[list[Scalar], list[Scalar]]:
    """25 points from the contact back to the clamp, seen from the contact: how far along n̂, and
    how far from the line of the force [L].

    With c = π/2 − χ: ds = dc / (√f √(1 − k² cos² c)), the distance from the line of the force is
    κ/f = 2 k sin c / √f, and the rod advances along −n̂ by (1 − 2 k² cos² c) ds. Error below 1e-8
    for k² ≤ ½.

    Lists, not arrays: written out point by point the whole check becomes one loop over the lanes,
    measured four times as fast.
    """
    return _points(plane, rod, force, _INTEGRATE, 1 / (BEND_POINTS - 1))


def bent_part_near(
    plane: BasePlane, rod: ContactOnRod, force: Scalar
) -> tuple[list[Scalar], list[Scalar]]:
    """The same of 17 points in the two steps next to the contact."""
    return _points(plane, rod, force, _INTEGRATE_NEAR, _NEAR_STEP / (FINE_POINTS - 1))


def _points(
    plane: BasePlane,
    rod: ContactOnRod,
    force: Scalar,
    integrate: Float[np.ndarray, "points n"],
    step: float,
) -> tuple[list[Scalar], list[Scalar]]:
    root, span, rates = _rates(plane, rod, force)
    advance = [
        sum((weight * rate for weight, rate in zip(row, rates, strict=True)), start=jnp.zeros(()))
        for row in integrate.tolist()
    ]
    return advance, _multiples_of_sine(
        span * step, 2 * jnp.sqrt(rod.modulus) / root, len(integrate)
    )


def bent_part_finely(
    plane: BasePlane, rod: ContactOnRod, force: Scalar
) -> tuple[Float[Array, "385"], Float[Array, "385"]]:
    """The same at 385 points, as arrays."""
    root, span, rates = _rates(plane, rod, force)
    angles = span * jnp.linspace(0.0, 1.0, FINE_POINTS)
    return jnp.asarray(_INTEGRATE_FINELY) @ jnp.stack(rates), 2 * jnp.sqrt(
        rod.modulus
    ) / root * jnp.sin(angles)


def _rates(
    plane: BasePlane, rod: ContactOnRod, force: Scalar
) -> tuple[Scalar, Scalar, list[Scalar]]:
    """√f, the range of c, and at the nodes the advance by c."""
    root = jnp.sqrt(jnp.maximum(force, _LEAST_FORCE))
    k2 = rod.modulus
    span = jnp.arctan2(root * plane.lever_arm / 2, plane.sin_a0)
    rates = []
    for node in _NODES.tolist():
        bent = k2 * cosine(span * node) ** 2
        rates.append((1 - 2 * bent) * lax.rsqrt(1 - bent) * (span / root))
    return root, span, rates


def _multiples_of_sine(angle: Scalar, factor: Scalar, count: int) -> list[Scalar]:
    """Factor times the sine of 0, 1, 2, … times an angle: sin (j + 1) h = 2 cos h sin j h − sin (j
    − 1) h.
    """
    twice_cosine = 2 * cosine(angle)
    sines = [jnp.zeros_like(angle), factor * sine(angle)]
    while len(sines) < count:
        sines.append(twice_cosine * sines[-1] - sines[-2])
    return sines


def contact_tangent(normal: Vector, side: Vector, rod: ContactOnRod) -> Vector:
    """Unit tangent at the contact, where a = α: it makes 2α with −n̂, towards `side`, the unit
    vector from the clamp to the line of the force.
    """
    k2 = rod.modulus
    return -(1 - 2 * k2) * normal + 2 * jnp.sqrt(jnp.maximum(k2 * (1 - k2), 0.0)) * side


def elastic_line(
    contact: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    side: Float[np.ndarray, "3"],
    force: float,
    modulus: float,
    contact_arc_length: float,
    arc_length: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n 3"]:
    """Points of the rod at given arc lengths, in closed form (mechanics.md, "Uniform straight
    rod"); model units.

    Parameters
    ----------
    contact, direction, side
        Contact point; unit vector n̂ of the contact force; unit vector from the clamp to the line
        of the force, square to n̂ (3,).
    force, modulus, contact_arc_length
        f [EI/L²], k² and s₁ [L] of the equilibrium.
    arc_length
        Where the points are wanted, 0 at the clamp [L]; beyond s₁ the rod is straight.

    Notes
    -----
    With u = √f (s₁ − s): sin a = k cd u, κ = 2 √f k k' sd u, and the advance left to the contact is
    (2 [E(am u) − k² sn u cd u] − u)/√f.
    """
    root = np.sqrt(max(force, _LEAST_FORCE))
    left = np.maximum(contact_arc_length - arc_length, 0.0)
    u = root * left
    sn, cn, dn, amplitude = ellipj(u, modulus)
    advance = (2 * (ellipeinc(amplitude, modulus) - modulus * sn * cn / dn) - u) / root
    distance = 2 * np.sqrt(modulus * (1 - modulus)) * sn / dn / root
    tangent = -(1 - 2 * modulus) * direction + 2 * np.sqrt(max(modulus * (1 - modulus), 0.0)) * side
    beyond = np.maximum(arc_length - contact_arc_length, 0.0)
    return np.asarray(
        contact
        + advance[:, None] * direction
        - distance[:, None] * side
        + beyond[:, None] * tangent
    )


def sampled_line(
    clamp: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    length: float,
    reach: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    force: float,
    contact_arc_length: float,
    count: int,
) -> Float[np.ndarray, "count 3"]:
    """`count` points of the rod, equally spaced in arc length from clamp to tip.

    Parameters
    ----------
    clamp, axis, length
        Clamp point (3,), unit tangent there (3,), and the rod's length, in units of the rod.
    reach, direction, force, contact_arc_length
        r = P1 − P0 (3,) [L], unit vector of the contact force (3,), its magnitude [EI/L²] and s₁
        [L]; a force of zero gives the straight rod.
    """
    s = np.linspace(0, 1, count)
    if force == 0:
        return np.asarray(clamp + length * s[:, None] * axis)
    side = reach - (reach @ direction) * direction
    lever_arm = float(np.linalg.norm(side))
    modulus = float((1 + direction @ axis) / 2 + force * lever_arm**2 / 4)
    line = elastic_line(reach, direction, side / lever_arm, force, modulus, contact_arc_length, s)
    return np.asarray(clamp + length * line)
