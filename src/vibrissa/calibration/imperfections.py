"""What a taper and a curvature at rest of the rod would change in the readings.

Neither is a parameter of the model. To first order each moves the contact that a given force F
makes by δp = −∂δU/∂F, where δU is what it adds to the elastic energy of the unchanged rod under
that force (Castigliano's theorem on the potential under a dead load). The readings change as if the
clamp were moved by δp.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ellipkinc

_QUADRATURE = np.polynomial.legendre.leggauss(24)
_HALVINGS = 50
_STEP = 1e-4
_STEEPEST = 0.5
"""k² in tangential contact."""
_SMALL = 1e-9

Column = Float[np.ndarray, "n 3"]
Strength = Float[np.ndarray, "n"]


class Load(NamedTuple):
    """Of a rod that leaves its clamp along +z: length L, stiffness EI, and forces on it, in the
    clamp's axes.
    """

    length: float
    stiffness: float
    force: Float[np.ndarray, "n 3"]


def tapering(load: Load) -> Column:
    """Move of the contact for radii r (1 − s/L), for a unit of this taper (n, 3): −2 EI ∫ (s/L) κ²
    ds of energy.
    """
    strength, angle, along, across, _ = _plane(load.force)
    slopes = _slopes(strength, angle, lambda *point: -2.0 * _moment_of_curvature(load, *point))
    return -(slopes[0][:, None] * along + (slopes[1] / strength)[:, None] * across)


def curving(load: Load, axis: int) -> Column:
    """Move of the contact for a unit of curvature at rest about the clamp's axis x or y (n, 3): −EI
    κ₀·b (turned angle) of energy, b the normal of the bending plane.
    """
    strength, angle, along, across, normal = _plane(load.force)

    def energy(force: Strength, leaning: Strength) -> Strength:
        return -load.stiffness * (leaning - 2 * np.arccos(np.sqrt(_modulus(load, force, leaning))))

    slopes = _slopes(strength, angle, energy)
    turned = np.cross([0.0, 0.0, 1.0], normal)
    sideways = (
        energy(strength, angle) * turned[:, axis] / (strength * np.maximum(np.sin(angle), _SMALL))
    )
    in_plane = slopes[0][:, None] * along + (slopes[1] / strength)[:, None] * across
    return -(normal[:, axis, None] * in_plane + sideways[:, None] * normal)


def _plane(force: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, ...]:
    """Magnitude, angle to the rod's axis, direction, that of a growing angle, and normal of the
    bending plane.
    """
    strength = np.maximum(np.linalg.norm(force, axis=1), np.finfo(float).tiny)
    along = force / strength[:, None]
    normal = np.cross([0.0, 0.0, 1.0], along)
    sine = np.linalg.norm(normal, axis=1)
    normal = np.where(
        sine[:, None] > _SMALL, normal / np.maximum(sine, _SMALL)[:, None], [0.0, 1.0, 0.0]
    )
    return strength, np.arctan2(sine, along[:, 2]), along, np.cross(normal, along), normal


def _slopes(
    force: Strength, angle: Strength, energy: Callable[[Strength, Strength], Strength]
) -> list[Strength]:
    """Central differences with respect to force and angle."""
    more = force * _STEP
    return [
        (energy(force + more, angle) - energy(force - more, angle)) / (2 * more),
        (energy(force, angle + _STEP) - energy(force, angle - _STEP)) / (2 * _STEP),
    ]


def _modulus(load: Load, force: Strength, angle: Strength) -> Strength:
    """k² = cos²(β₁/2), β₁ the angle between rod and force at the contact: ½ in tangential contact,
    and that of the rod's whole length in tip contact.
    """
    least = np.cos(angle / 2) ** 2
    low, high = least, np.where(least < _STEEPEST, _STEEPEST, 1.0)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        longer = _arc_length(load, force, angle, middle)[0] > load.length
        low, high = np.where(longer, low, middle), np.where(longer, middle, high)
    return (low + high) / 2


def _arc_length(
    load: Load, force: Strength, angle: Strength, modulus: Strength
) -> tuple[Strength, Strength]:
    """From clamp to contact, √(EI/F) (K(k) − F(ζ₀, k)), and the amplitude ζ₀ at the clamp, sin ζ₀ =
    cos(φ/2)/k.
    """
    amplitude = np.arcsin(
        np.clip(np.cos(angle / 2) / np.sqrt(np.maximum(modulus, _SMALL)), 0.0, 1.0)
    )
    unit = np.sqrt(load.stiffness / force)
    return unit * (ellipkinc(np.pi / 2, modulus) - ellipkinc(amplitude, modulus)), amplitude


def _moment_of_curvature(load: Load, force: Strength, angle: Strength) -> Strength:
    """EI ∫ (s/L) κ² ds with κ = 2 k √(F/EI) cos ζ and ds = √(EI/F) dζ/√(1 − k² sin² ζ)."""
    modulus = _modulus(load, force, angle)
    _, amplitude = _arc_length(load, force, angle, modulus)
    nodes, weights = _QUADRATURE
    half = (np.pi / 2 - amplitude)[:, None] / 2
    zeta = amplitude[:, None] + half * (nodes + 1)
    unit = np.sqrt(load.stiffness / force)[:, None]
    place = unit * (ellipkinc(zeta, modulus[:, None]) - ellipkinc(amplitude, modulus)[:, None])
    density = (
        place
        * 4
        * modulus[:, None]
        * np.cos(zeta) ** 2
        / unit
        / np.sqrt(1 - modulus[:, None] * np.sin(zeta) ** 2)
    )
    return load.stiffness / load.length * np.sum(weights * half * density, axis=1)
