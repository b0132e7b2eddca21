"""Whether surfaces through either half of the sweeps differ by as much as they say."""

import numpy as np
from scipy.special import ndtri

from vibrissa.shape.kernel import JET
from vibrissa.shape.noise import Noise
from vibrissa.shape.posterior import Data, Information, Posterior, information
from vibrissa.shape.sites import Sites

_PLACES = 400
"""Contacts at which the two are compared."""
_SHARE = 0.95
"""Of the places, within the interval that is to hold them."""
_LEAST, _BEFORE, _BELIEVED = 24, 10, 0.7
"""Sweeps below which nothing is concluded, and sweeps that count as much as the belief that this is
the factor: of 16 sweeps, of one block in three, 95 % intervals near contacts held 87 %. With a
belief of 0.5, 28 of the sets below would hold 93 to 97 %, but 24 sweeps over half an ellipsoid
89 %.
"""
_DRAWN = 0.2
"""Weight of how far means are drawn, in the geometric mean with how far halves differ. Of 46 sets
of contacts of 23 objects after 50 to 85 sweeps, 95 % intervals near contacts hold 93 to 97 % for
25, less for 10 (five of them of objects with sharp edges), and more for 11. With halves alone,
never more than 1, and nothing added where means are drawn (`stated`), that was 20, 15 and 11; cones
and cylinders with round rims had 84 to 89 %, and have 89 to 93 %.
"""
_TINY = 1e-300
"""Variance that is none."""


def told_by_half(data: Data, noise: Noise, sites: Sites) -> list[Information]:
    """What either half of the sweeps tells; both together are all."""
    half = np.array([sites.half[rows[0]] for rows in noise.groups])
    return [
        information(
            data, noise._replace(groups=[noise.groups[row] for row in np.flatnonzero(half == side)])
        )
        for side in (0, 1)
    ]


def agreement(known: Posterior, data: Data, halves: list[Information], sweeps: int) -> float:
    """Factor of deviations near contacts: below 1 where two surfaces that share no sweep differ by
    less than they say, as random surfaces of one length are rougher than balls, tori, or a block's
    faces, and above it where they differ by more.

    With unknowns of unit variance before, and precisions A and B given either half, the means of
    the two differ by a covariance A⁻¹ + B⁻¹ − 2 A⁻¹B⁻¹. What both are wrong about does not show in
    that, but in how far the mean m given all is drawn towards zero: by Q⁻¹m, of covariance
    Q⁻² − Q⁻³, with Q the precision.
    """
    if sweeps < _LEAST:
        return 1.0
    found = [told.posterior(known.basis) for told in halves]
    values = data.rows[:, ::JET][:, :: -(-len(data.target) // _PLACES)]
    by = [each.solved(values) for each in found]
    apart = (found[0].mean - found[1].mean) @ values
    variance = np.einsum("mn,mn->n", values, by[0] + by[1])
    variance -= 2 * np.einsum("mn,mn->n", *by)
    # Where both halves have the same exact contacts, rounding may leave less than nothing.
    deviation = np.sqrt(np.maximum(variance, _TINY))
    ratio = np.quantile(np.abs(apart) / deviation, _SHARE) / ndtri(0.5 + _SHARE / 2)
    pulled = known.solved(values)
    expected = np.einsum("mn,mn->n", pulled, pulled - known.solved(pulled))
    drawn = np.mean((known.mean @ pulled) ** 2 / np.maximum(expected, _TINY))
    shown = ratio ** (1 - _DRAWN) * drawn ** (_DRAWN / 2)
    told = _BEFORE * _BELIEVED**2 + sweeps * shown**2
    return float(np.sqrt(told / (_BEFORE + sweeps)))
