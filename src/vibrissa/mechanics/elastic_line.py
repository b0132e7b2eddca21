"""The exact shape of the uniform straight rod: bent from clamp to contact, straight from there to
its tip.
"""

import numpy as np
import scipy
from jaxtyping import Float

_LEAST_FORCE = 1e-12
"""Least force [EI/L²] under which the rod is drawn."""


def elastic_line(
    contact: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    side: Float[np.ndarray, "3"],
    force: float,
    modulus: float,
    contact_arc_length: float,
    arc_length: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n 3"]:
    """Points of the rod at given arc lengths, in closed form (mechanics.md, "The uniform rod in
    closed form"); model units.

    Parameters
    ----------
    contact, direction, side
        Contact point; unit vector n̂ of the contact force; unit vector from the clamp to the line
        of the force, perpendicular to n̂ (3,).
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
    sn, cn, dn, amplitude = scipy.special.ellipj(u, modulus)
    advance = (
        2 * (scipy.special.ellipeinc(amplitude, modulus) - modulus * sn * cn / dn) - u
    ) / root
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
    """`count` points of the rod, equally spaced in arc length from clamp to tip; NaN if no rod
    takes this shape under this force.

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
    if not 0 <= modulus <= 1:
        return np.full((count, 3), np.nan)
    line = elastic_line(reach, direction, side / lever_arm, force, modulus, contact_arc_length, s)
    return np.asarray(clamp + length * line)


def force_of(
    incidence: float,
    reach: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
) -> float:
    """Magnitude [EI/L²] of the contact force for a given incidence; others as in `sampled_line`."""
    lever_arm = np.linalg.norm(reach - (reach @ direction) * direction)
    return float(4 * (incidence - (1 + direction @ axis) / 2) / lever_arm**2)


def directors(
    direction: Float[np.ndarray, "3"],
    side: Float[np.ndarray, "3"],
    force: float,
    modulus: float,
    contact_arc_length: float,
    arc_length: Float[np.ndarray, "n"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"], Float[np.ndarray, "3"]]:
    """Unit tangents, curvatures [1/L] about the plane's unit normal, and that normal; arguments and
    notation as in `elastic_line`.
    """
    sn, cn, dn, _ = scipy.special.ellipj(
        np.sqrt(force) * (contact_arc_length - arc_length), modulus
    )
    sine, cosine = np.sqrt(modulus) * cn / dn, np.sqrt(1 - modulus) / dn
    tangent = -(1 - 2 * sine**2)[:, None] * direction + (2 * sine * cosine)[:, None] * side
    curvature = 2 * np.sqrt(force * modulus * (1 - modulus)) * sn / dn
    return tangent, curvature, np.cross(direction, side)
