"""Whether a sweep is slow enough for statics."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.geometry.checks import positive
from vibrissa.rod import Rod
from vibrissa.trail import Trail

RATIO_ALLOWED = 0.1


@dataclass(frozen=True)
class QuasiStatic:
    """The rod's own time scale compared with that of the sweep.

    Attributes
    ----------
    natural_frequency
        First bending frequency of the clamped rod with a free end [Hz].
    sweep_frequency
        Fastest relative rate of change of the support reactions [1/s], of force or moment,
        whichever is faster, each relative to its largest value.
    ratio
        `sweep_frequency` over the rod's angular frequency; inertia adds to the reactions on the
        order of its square.
    holds
        Whether the ratio is at most 0.1, so that inertia stays near 1 %.
    """

    natural_frequency: float
    sweep_frequency: float
    ratio: float
    holds: bool


def quasi_static(
    rod: Rod,
    trail: Trail,
    force: Float[np.ndarray, "*trail n 3"],
    moment: Float[np.ndarray, "*trail n 3"],
    smooth: Bool[np.ndarray, "*trail n"],
    speed: float,
) -> QuasiStatic:
    """Compare time scales for a clamp that moves at `speed` [m/s].

    Parameters
    ----------
    rod, trail, force, moment
        Rod and trail, and the support reactions along it (…, 3).
    smooth
        Which steps count (…), given by the position at their end: those without a snap.
    speed
        Of the clamp along its path, or of the rod's tip where the clamp only turns.

    Raises
    ------
    ValueError
        If the rod has no density, or the speed is not positive.
    """
    positive(speed, "speed")
    natural = rod.first_natural_frequency()
    moved = np.linalg.norm(np.diff(trail.position, axis=-2), axis=-1)
    turned = rod.length * np.linalg.norm(np.diff(trail.axis, axis=-2), axis=-1)
    duration = np.maximum(moved, turned) / speed
    fastest = 0.0
    for part in (force, moment):
        change = np.linalg.norm(np.diff(part, axis=-2), axis=-1)
        largest = np.nanmax(np.linalg.norm(part, axis=-1), initial=0.0)
        valid = smooth[..., 1:] & (duration > 0) & np.isfinite(change)
        if largest > 0 and valid.any():
            fastest = max(fastest, float(np.max(change[valid] / duration[valid])) / float(largest))
    ratio = fastest / (2 * np.pi * natural)
    return QuasiStatic(natural, fastest, float(ratio), bool(ratio <= RATIO_ALLOWED))
