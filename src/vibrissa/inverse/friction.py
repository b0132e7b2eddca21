"""Friction and normals from the reconstructed contacts themselves.

With friction the force direction d is not the object's normal n. But the contacts show how the
rod's material point moves over the object, along the unit vector ŵ of dP₁ − t ds₁ (mechanics.md,
"Slip"), and where it slides, d leans against it by the friction angle:

    d = (n − μ ŵ)/√(1 + μ²),    so    μ = −d·ŵ / √(1 − (d·ŵ)²),    n = (d − (d·ŵ) ŵ)/√(1 − (d·ŵ)²).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import median_abs_deviation

from vibrissa.contacts import ContactKind, Status
from vibrissa.inverse.result import Reconstruction

_LEAST_WINDOW = 5
_LARGEST_WINDOW = 401
# Motion over a window against the noise of its ends.
_MOTION_TO_NOISE = 12.0
# Slower than this share of the median the contact counts as at rest, where ŵ says nothing.
_AT_REST = 0.1
_MOST_DEVIATIONS = 4.0
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class FrictionEstimate:
    """What the contacts of a sweep say of friction.

    Attributes
    ----------
    friction
        Coulomb's coefficient: median over the sliding samples.
    standard_error
        Of the coefficient, from the spread of the samples (median absolute deviation), a window of
        samples counting as one.
    normal
        (…, 3) outward unit normal of the object; NaN where the contact does not slide or is not
        known.
    sliding
        (…, 3) unit vector along which the rod slides over the object; NaN likewise.
    window
        Samples over which motions were taken.
    """

    friction: float
    standard_error: float
    normal: Float[np.ndarray, "*trail n 3"]
    sliding: Float[np.ndarray, "*trail n 3"]
    window: int


def estimate_friction(found: Reconstruction, *, window: int | None = None) -> FrictionEstimate:
    """Coefficient of friction and normals of the object from the contacts of sweeps.

    Parameters
    ----------
    found
        Contacts (n, …) or (m, n, …), in the order of the sweep.
    window
        Odd number of samples, at least 5, over which the motion of the contact is taken (quadratic
        least squares). Default: the smallest over which the contact moves by twelve times its
        noise; 5 where the noise is not known.

    Raises
    ------
    ValueError
        If the window is not allowed, or no stretch of contacts is long enough for it.

    Notes
    -----
    Where the contact sticks or rolls the force lies anywhere inside the cone; such samples take no
    part. Without a second look (another direction of sweeping) nothing more than the cone around
    the force is known of the normal there.
    """
    from scipy.signal import savgol_coeffs  # noqa: PLC0415

    if window is None:
        window = _window(found)
    if window < _LEAST_WINDOW or window % 2 == 0:
        raise ValueError(
            f"window = {window!r}; allowed is an odd number of at least {_LEAST_WINDOW}"
        )
    n = found.kind.shape[-1]
    usable = (found.in_contact & (found.status == Status.OK)).reshape(-1, n)
    tangent = contact_tangents(found).reshape(-1, n, 3)
    point, direction = (part.reshape(-1, n, 3) for part in (found.point, found.force_direction))
    arc_length = found.arc_length.reshape(-1, n)
    # Bending between tip and tangential contact gives the path a kink in s₁; a window must not span
    # it.
    whole = _full_windows(usable, found.kind.reshape(-1, n), window)
    if not whole.any():
        raise ValueError(
            f"window = {window}: no contact lasts that many samples; allowed is a smaller window "
            "or a denser recording"
        )
    slope = savgol_coeffs(window, 2, deriv=1, use="dot")

    def rate(values: Float[np.ndarray, "m n *k"]) -> Float[np.ndarray, "m n *k"]:
        rates, half = np.full(values.shape, np.nan), window // 2
        rates[:, half : n - half] = sliding_window_view(values, window, axis=1) @ slope
        return rates

    motion = rate(point) - tangent * rate(arc_length)[..., None]
    motion[~whole] = np.nan
    speed = np.linalg.norm(motion, axis=-1)
    slides = whole & (speed > _AT_REST * np.median(speed[whole]))
    sliding = np.where(slides[..., None], motion / np.where(slides, speed, 1.0)[..., None], np.nan)
    lean = np.einsum("...i,...i->...", direction, sliding)
    cosine = np.sqrt(1 - lean**2)
    values = (-lean / cosine)[slides]
    friction = float(np.median(values))
    spread = float(median_abs_deviation(values, scale="normal"))
    # Where the contact has just jumped, or turns within the window, the lean is another.
    fits = (
        np.abs(np.where(slides, -lean / cosine, np.inf) - friction)
        <= _MOST_DEVIATIONS * spread + _ROUNDING
    )
    sliding = np.where(fits[..., None], sliding, np.nan)
    normal = (direction - lean[..., None] * sliding) / cosine[..., None]
    shape = found.point.shape
    independent = max(1.0, slides.sum() / window)
    return FrictionEstimate(
        friction,
        float(np.sqrt(np.pi / 2) * spread / np.sqrt(independent)),
        normal.reshape(shape),
        sliding.reshape(shape),
        window,
    )


def contact_tangents(found: Reconstruction) -> Float[np.ndarray, "*trail n 3"]:
    """Unit tangents of the rod at the contact: they make 2α with −d, sin² α = k², away from the
    clamp's side of the force.
    """
    reach = found.point - found.reactions.trail.position
    direction = found.force_direction
    side = reach - np.einsum("...i,...i->...", reach, direction)[..., None] * direction
    with np.errstate(invalid="ignore", divide="ignore"):
        side = side / np.linalg.norm(side, axis=-1, keepdims=True)
    k2 = found.modulus[..., None]
    return np.asarray(-(1 - 2 * k2) * direction + 2 * np.sqrt(np.maximum(k2 * (1 - k2), 0)) * side)


def _window(found: Reconstruction) -> int:
    if found.covariance is None:
        return _LEAST_WINDOW
    contact = found.in_contact & (found.status == Status.OK)
    moved = np.linalg.norm(np.diff(found.point, axis=-2), axis=-1)
    if contact.sum() < _LEAST_WINDOW:
        return _LEAST_WINDOW
    noise = float(np.median(np.sqrt(np.trace(found.covariance[contact], axis1=-2, axis2=-1))))
    # Per sample the contact moves about as the clamp does; its own steps are mostly noise.
    clamp = np.linalg.norm(np.diff(found.reactions.trail.position, axis=-2), axis=-1)
    step = float(np.median(np.minimum(moved, clamp)[contact[..., 1:] & np.isfinite(moved)]))
    # The slope of a straight line through n equally noisy samples: σ √(12/n³) a sample.
    count = (12 * (_MOTION_TO_NOISE * noise / max(step, 1e-300)) ** 2) ** (1 / 3)
    return int(min(_LARGEST_WINDOW, max(_LEAST_WINDOW, 2 * (int(count) // 2) + 1)))


def _full_windows(
    usable: Bool[np.ndarray, "m n"], kind: np.ndarray, window: int
) -> Bool[np.ndarray, "m n"]:
    whole = np.zeros_like(usable)
    for contact in (ContactKind.TIP, ContactKind.TANGENTIAL):
        counts = np.cumsum(np.pad(usable & (kind == contact), ((0, 0), (1, 0))), axis=1)
        if usable.shape[1] >= window:
            whole[:, window // 2 : usable.shape[1] - window // 2] |= (
                counts[:, window:] - counts[:, :-window] == window
            )
    return whole
