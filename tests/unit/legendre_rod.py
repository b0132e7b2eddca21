"""The uniform straight rod in Legendre's integrals with mpmath, as mechanics.md states it ("Uniform
straight rod").

With q = κ₀/(2√f) = √w the formulas for s₁ and I₁ in units of the lever arm ℓ = κ₀/f = 2√w/√f are
functions of sin a₀ and w alone. For a force that pulls, w < 0, they continue through complex
amplitudes to real values.
"""

from typing import NamedTuple

import mpmath
from mpmath import mpf


class Contact(NamedTuple):
    """s₁/ℓ, I₁/ℓ, and the bending energy in units of fℓ."""

    sigma: mpf
    iota: mpf
    energy: mpf


def contact(sin_a0: mpf, w: mpf) -> Contact:
    """The closed form of mechanics.md; at w = 0 its limit, the straight rod."""
    sin_a0, w = mpmath.mpmathify(sin_a0), mpmath.mpmathify(w)
    if w == 0:
        doubled = 2 * mpmath.asin(sin_a0)
        return Contact(1 / mpmath.sin(doubled), mpmath.cot(doubled), mpf(0))
    k2 = sin_a0**2 + w
    k, q = mpmath.sqrt(k2), mpmath.sqrt(w)
    base = sin_a0 * mpmath.sqrt(1 - k2)
    chi = mpmath.atan2(q, base) if w > 0 else mpmath.atan(q / base)
    F, E = mpmath.ellipf(chi, k2), mpmath.ellipe(chi, k2)
    sin_chi0 = sin_a0 / k
    bent = E - k2 * mpmath.sin(chi) * sin_chi0
    # √f = 2q/ℓ, so 1/√f = ℓ/(2q), and U = 2√f (…) = fℓ (…)/q.
    sigma, iota, energy = F / (2 * q), (2 * bent - F) / (2 * q), (bent - (1 - k2) * F) / q
    return Contact(mpmath.re(sigma), mpmath.re(iota), mpmath.re(energy))


def slopes(sin_a0: float, w: float) -> list[list[mpf]]:
    """∂(σ, ι)/∂(sin a₀, w) by central differences in 40 digits."""
    step = mpf(10) ** -12
    a, b = mpf(sin_a0), mpf(w)
    by_a, by_w = (
        [(x - y) / (2 * step) for x, y in zip(contact(*ahead), contact(*behind), strict=True)][:2]
        for ahead, behind in (((a + step, b), (a - step, b)), ((a, b + step), (a, b - step)))
    )
    return [[by_a[0], by_w[0]], [by_a[1], by_w[1]]]
