"""What a taper and a curvature at rest of the rod would change in the readings.

Neither is a parameter of the model. To first order each moves the contact that a given force F
makes by δp = −∂δU/∂F, where δU is what it adds to the elastic energy of the unchanged rod under
that force (Castigliano's theorem on the potential under a dead load). The readings change as if the
clamp were moved by δp.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ellipkinc

from vibrissa.calibration.arrays import Numbers, Vectors
from vibrissa.numerics.bracket import roots

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
"""Exact to rounding for an integrand as smooth as a rod's curvature."""
_STEP = 1e-4
"""Relative, of central differences: errors of 1e-8 by curvature, and 1e-11 by rounding."""
_STEEPEST = 0.5
"""k² in tangential contact."""
_LARGEST = 1 - 1e-12
"""k² up to which a rod has an end."""
_SMALL = 1e-9
"""Stands for zero in what is divided by, and changes nothing else by more than rounding."""


Several = Float[np.ndarray, "*#n"]


class Load(NamedTuple):
    """Of a rod that leaves its clamp along +z: length L, stiffness EI, and forces on it, in the
    clamp's axes.
    """

    length: float
    stiffness: float
    force: Vectors


def tapering(load: Load) -> Vectors:
    """Move of the contact for radii r (1 − s/L), for a unit of this taper (n, 3): −2 EI ∫ (s/L) κ²
    ds of energy.
    """
    return _move(load, lambda force: -2.0 * _moment_of_curvature(load, force))


def curving(load: Load, axis: int) -> Vectors:
    """Move of the contact for a unit of curvature at rest about the clamp's axis x or y (n, 3): −EI
    κ₀·b (turned angle) of energy, b the normal of the bending plane.
    """

    def energy(force: Vectors) -> Numbers:
        strength, angle = _polar(force)
        turned = angle - 2 * np.arccos(np.sqrt(_modulus(load, strength, angle)))
        normal = np.cross([0.0, 0.0, 1.0], force)[:, axis]
        return -load.stiffness * turned * normal / np.maximum(strength * np.sin(angle), _SMALL)

    return _move(load, energy)


def _move(load: Load, energy: Callable[[Vectors], Numbers]) -> Vectors:
    """−∂δU/∂F by central differences."""
    step = _STEP * _polar(load.force)[0]
    ends = [
        energy(load.force + step[:, None] * one) - energy(load.force - step[:, None] * one)
        for one in np.eye(3)
    ]
    return -np.stack(ends, axis=1) / (2 * step[:, None])


def _polar(force: Vectors) -> tuple[Numbers, Numbers]:
    """Magnitude, and angle to the rod's axis."""
    across = np.hypot(force[:, 0], force[:, 1])
    strength = np.maximum(np.hypot(across, force[:, 2]), np.finfo(float).tiny)
    return strength, np.arctan2(across, force[:, 2])


def _modulus(load: Load, force: Numbers, angle: Numbers) -> Numbers:
    """k² = cos²(β₁/2), β₁ the angle between rod and force at the contact: ½ in tangential contact,
    and that of the rod's whole length in tip contact.
    """
    least = np.cos(angle / 2) ** 2
    largest = np.where(least < _STEEPEST, _STEEPEST, _LARGEST)

    def longer(square: Float[np.ndarray, "j n"], row: Any) -> Float[np.ndarray, "j n"]:
        return _arc_length(load, force[row, None], angle[row, None], square)[0] - load.length

    reach = longer(largest[:, None], slice(None))[:, 0]
    return roots(longer, (least, largest), (np.full(len(least), -load.length), reach))


def _arc_length(
    load: Load, force: Several, angle: Several, modulus: Several
) -> tuple[Several, Several]:
    """From clamp to contact, √(EI/F) (K(k) − F(ζ₀, k)), and the amplitude ζ₀ at the clamp, sin ζ₀ =
    cos(φ/2)/k.
    """
    sine = np.cos(angle / 2) / np.sqrt(np.maximum(modulus, _SMALL))
    amplitude = np.arcsin(np.clip(sine, 0.0, 1.0))
    unit = np.sqrt(load.stiffness / force)
    return unit * (ellipkinc(np.pi / 2, modulus) - ellipkinc(amplitude, modulus)), amplitude


def _moment_of_curvature(load: Load, force: Vectors) -> Numbers:
    """EI ∫ (s/L) κ² ds with κ = 2 k √(F/EI) cos ζ and ds = √(EI/F) dζ/√(1 − k² sin² ζ)."""
    strength, angle = _polar(force)
    modulus = _modulus(load, strength, angle)
    amplitude, square = _arc_length(load, strength, angle, modulus)[1], modulus[:, None]
    half = (np.pi / 2 - amplitude)[:, None] / 2
    zeta = amplitude[:, None] + half * (_NODES + 1)
    place = ellipkinc(zeta, square) - ellipkinc(amplitude, modulus)[:, None]
    density = place * 4 * square * np.cos(zeta) ** 2 / np.sqrt(1 - square * np.sin(zeta) ** 2)
    return load.stiffness / load.length * np.sum(_WEIGHTS * half * density, axis=1)
