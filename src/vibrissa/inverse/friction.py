"""Friction and normals from the reconstructed contacts themselves.

With friction the force direction d is not the object's normal n. But the contacts show how the
rod's material point moves over the object, along the unit vector ŵ of dP₁ − t ds₁ (mechanics.md,
"Slip"); where it slides, d leans against that motion by the friction angle:

    d = (n − μ ŵ)/√(1 + μ²),    so    μ = −d·ŵ / √(1 − (d·ŵ)²),    n = (d − (d·ŵ) ŵ)/√(1 − (d·ŵ)²).
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import scipy
from scipy.ndimage import morphological_gradient

from vibrissa.brief import brief
from vibrissa.contacts import Status
from vibrissa.inverse.arrays import Vectors
from vibrissa.inverse.result import Reconstruction
from vibrissa.mechanics.elastica import contact_tangent

_LEAST_WINDOW = 5
_LARGEST_WINDOW = 401
# Motion over a window, relative to the noise at its ends.
_MOTION_TO_NOISE = 12.0
# Below this fraction of the median speed the contact counts as at rest, where ŵ is meaningless.
_AT_REST = 0.1
_MOST_DEVIATIONS = 4.0
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class FrictionEstimate:
    """What the contacts of a sweep say about friction.

    Attributes
    ----------
    friction
        Coulomb friction coefficient: median over the sliding samples.
    standard_error
        Of the coefficient, from the spread of the samples (median absolute deviation), each window
        of samples counting as one.
    normal
        (…, 3) outward unit normal of the object; NaN where the contact does not slide or is not
        known.
    sliding
        (…, 3) unit vector along which the rod slides over the object; NaN likewise.
    window
        Number of samples over which the motion was fitted.
    """

    friction: float
    standard_error: float
    normal: Vectors
    sliding: Vectors
    window: int

    __repr__ = brief


def estimate_friction(found: Reconstruction, *, window: int | None = None) -> FrictionEstimate:
    """Coefficient of friction and normals of the object from the contacts of sweeps.

    Parameters
    ----------
    found
        Contacts (n, …) or (m, n, …), in the order of the sweep.
    window
        Odd number of samples, at least 5, over which the contact's motion is fitted (quadratic
        least squares). Default: the smallest over which the contact moves by twelve times its
        noise; 5 if the noise is unknown.

    Raises
    ------
    ValueError
        If the window is not allowed, or no stretch of contacts is long enough for it.

    Notes
    -----
    Where the contact sticks or rolls, the force may lie anywhere inside the cone; such samples are
    left out. There the normal is known only to lie in the cone around the force, unless a sweep in
    another direction adds to it.
    """
    if window is None:
        window = _window(found)
    if window < _LEAST_WINDOW or window % 2 == 0:
        raise ValueError(
            f"window = {window!r}; allowed is an odd number of at least {_LEAST_WINDOW}"
        )
    usable, direction = found.in_contact & (found.status == Status.OK), found.force_direction
    # A change between tip and tangential contact puts a kink into s₁; a window must not span it,
    # nor reach beyond the sweep.
    kind = np.where(usable, found.kind, 0)
    size = (1, window)[-kind.ndim :]
    differs = morphological_gradient(kind, size, mode="constant", cval=-1)
    whole = usable & (differs == 0)
    if not whole.any():
        raise ValueError(
            f"window = {window}: no contact lasts that many samples; allowed is a smaller window "
            "or a denser recording"
        )
    way = np.concatenate([found.point, found.arc_length[..., None]], axis=-1)
    rates = scipy.signal.savgol_filter(way, window, 2, deriv=1, axis=-2, mode="nearest")
    moved = rates[..., :3] - contact_tangents(found) * rates[..., 3:]
    motion = np.where(whole[..., None], moved, np.nan)
    speed = np.linalg.norm(motion, axis=-1)
    slides = whole & (speed > _AT_REST * np.median(speed[whole]))
    sliding = motion / np.where(slides, speed, np.nan)[..., None]
    lean = np.sum(direction * sliding, axis=-1)
    cosine = np.sqrt(1 - lean**2)
    coefficients = -lean / cosine
    friction = float(np.median(coefficients[slides]))
    spread = float(scipy.stats.median_abs_deviation(coefficients[slides], scale="normal"))
    # Where the contact has just jumped, or turns within the window, the lean is different.
    fits = np.abs(coefficients - friction) <= _MOST_DEVIATIONS * spread + _ROUNDING
    sliding = np.where(fits[..., None], sliding, np.nan)
    normal = (direction - lean[..., None] * sliding) / cosine[..., None]
    independent = max(1.0, slides.sum() / window)
    return FrictionEstimate(
        friction,
        float(np.sqrt(np.pi / 2) * spread / np.sqrt(independent)),
        normal,
        sliding,
        window,
    )


def contact_tangents(found: Reconstruction) -> Vectors:
    """Unit tangents of the rod at the contact, away from the clamp's side of the force."""
    reach, direction = found.point - found.reactions.trail.position, found.force_direction
    side = reach - np.sum(reach * direction, axis=-1, keepdims=True) * direction
    with np.errstate(invalid="ignore", divide="ignore"):
        side = side / np.linalg.norm(side, axis=-1, keepdims=True)
    tangents = jnp.vectorize(contact_tangent, signature="(k),(k),()->(k)")
    return np.asarray(tangents(direction, side, found.modulus))


def _window(found: Reconstruction) -> int:
    contact = found.in_contact & (found.status == Status.OK)
    if found.covariance is None or contact.sum() < _LEAST_WINDOW:
        return _LEAST_WINDOW
    noise = float(np.median(np.sqrt(np.trace(found.covariance[contact], axis1=-2, axis2=-1))))
    # Per sample the contact moves about as the clamp does; its own steps are mostly noise.
    moved, clamp = (
        np.linalg.norm(np.diff(points, axis=-2), axis=-1)
        for points in (found.point, found.reactions.trail.position)
    )
    step = float(np.median(np.minimum(moved, clamp)[contact[..., 1:] & np.isfinite(moved)]))
    # The slope of a straight line through n equally noisy samples: σ √(12/n³) per sample.
    count = (12 * (_MOTION_TO_NOISE * noise / max(step, 1e-300)) ** 2) ** (1 / 3)
    return int(np.clip(2 * (int(count) // 2) + 1, _LEAST_WINDOW, _LARGEST_WINDOW))
