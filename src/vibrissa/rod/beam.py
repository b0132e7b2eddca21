"""Small deflections of a clamped straight beam of varying section, in units L = EI = ρA = 1 at the
clamp.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

Along = Callable[[Float[np.ndarray, "e g"]], Any]

_ELEMENTS = 64
"""First frequency to 1e-7 for a cone, 1e-8 for a uniform beam (`test_rod_section.py`)."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def first_frequency(bending: Along, mass: Along, breaks: tuple[float, ...]) -> float:
    """First angular frequency: cubic Hermite elements that end at kinks."""
    ends, x = _elements(breaks)
    h = np.diff(ends)[:, None, None]
    xi = (1 + _NODES) / 2
    one = np.ones_like(xi)
    value = np.array([1 - 3 * xi**2 + 2 * xi**3, xi * (1 - xi) ** 2, 3 * xi**2 - 2 * xi**3])
    value = np.vstack([value, [xi**2 * (xi - 1)]])
    bend = np.array([12 * xi - 6 * one, 6 * xi - 4 * one, 6 * one - 12 * xi, 6 * xi - 2 * one])
    units = np.stack([np.ones(len(h)), h[:, 0, 0], np.ones(len(h)), h[:, 0, 0]], axis=1)[:, :, None]
    shapes, bends = value * units, bend * units / h**2
    weights = h[:, :, 0] * _WEIGHTS / 2
    size = 2 * len(ends)
    stiffness, inertia = np.zeros((size, size)), np.zeros((size, size))
    for matrix, functions, along in ((stiffness, bends, bending), (inertia, shapes, mass)):
        parts = np.einsum("eig,ejg,eg->eij", functions, functions, weights * np.asarray(along(x)))
        for element, part in enumerate(parts):
            at = slice(2 * element, 2 * element + 4)
            matrix[at, at] += part
    # The largest 1/ω² is free of the rounding that the smallest ω² has beside large ones.
    held, last = stiffness[2:, 2:], size - 3
    found = eigh(inertia[2:, 2:], held, eigvals_only=True, subset_by_index=[last, last])
    return float(1 / np.sqrt(found[0]))


def sag(bending: Along, mass: Along, breaks: tuple[float, ...]) -> float:
    """Deflection of the tip of a level beam under its own weight, ∫ (1 − x) M/EI dx with M(x) =
    ∫ₓ¹ ρA (ξ − x) dξ; 1/8 for a uniform one.
    """
    ends, x = _elements(breaks)
    half = np.diff(ends)[:, None] / 2
    weight = half * _WEIGHTS * np.asarray(mass(x))
    # Of all elements farther out, and of the rest of the same one.
    beyond = np.concatenate([np.cumsum(weight.sum(1)[::-1])[::-1][1:], [0.0]])[:, None]
    lever = np.concatenate([np.cumsum((weight * x).sum(1)[::-1])[::-1][1:], [0.0]])[:, None]
    inner = x[..., None] + (ends[1:, None, None] - x[..., None]) * (1 + _NODES) / 2
    share = (ends[1:, None] - x)[..., None] * _WEIGHTS / 2 * np.asarray(mass(inner))
    moment = lever - x * beyond + np.sum(share * (inner - x[..., None]), axis=-1)
    return float(np.sum(half * _WEIGHTS * (1 - x) * moment / np.asarray(bending(x))))


def _elements(
    breaks: tuple[float, ...],
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "e g"]]:
    """Ends of elements, and Gauss points in each."""
    ends = np.unique([*np.linspace(0, 1, _ELEMENTS + 1), *breaks])
    return ends, ends[:-1, None] + np.diff(ends)[:, None] * (1 + _NODES) / 2
