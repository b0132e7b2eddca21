"""The model of a sweep, stated once for offline and live smoothing: how states enter a sample, what
a contact shows, and which constraints hold.
"""

import math
from types import ModuleType
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from vibrissa.inverse.smoothing.kalman import ROWS, WRENCH, Entry, Step
from vibrissa.inverse.smoothing.manifold import (
    ARC_LENGTH,
    AT_REST,
    COORDINATES,
    LOADS,
    TILT,
    Linear,
    chosen,
)
from vibrissa.inverse.smoothing.series import (
    FREE,
    GO_ON,
    JUMP,
    KINK,
    TANGENTIAL,
    TIP,
    Codes,
    Fit,
    Labels,
    Rates,
)
from vibrissa.tolerances import PARAMETERS, SetupErrors

TILT_SPREAD = 3e-3
"""Standard deviation [rad] of the tilt where nothing else is known of it: a sixth of a degree, as
rods are straight and clamps are true.
"""
ARC_LENGTH_SPREAD = 0.3
"""Standard deviation of s₁ where nothing is known of it: about that of a uniform one."""
_BEND = np.array([1 / 15, 1 / 15, 1 / 15, 1 / 6, 0])
"""By how much the rates of loads and s₁ change at a change of phase, in rates of which nothing is
known: thrice what a sphere makes of them.
"""
_PINNED, _EXACT = 1e-12, 1e-6
"""Variance, and standard deviation, of what holds exactly: far below what noise tells, far above
rounding."""
_FRICTION, _UNRELATED = 0.2, 4
"""Standard deviation of k² about ½ in tangential contact, that of a coefficient of friction of 0.4
((sin atan μ)/2), and how often in a contact it is another one.
"""
_LOAD_SPREAD = 2.0
"""Standard deviation of loads of which nothing is known: those of a strongly bent rod."""


def incidence_spread_of(friction: float | None, errors: SetupErrors | None) -> float | None:
    """Standard deviation of k² about ½ in tangential contact by what the setup tolerates; None
    where friction may make it another one.

    k² = ½ + (m0²/2EI − f0·t0)/2f, whose two parts cancel there, and each is at most ½: in the
    readings of another rod it is off by at most half of 2 δm + δf + δEI, relative, and of the
    clamp's turn [rad].
    """
    if friction != 0:
        return None
    if errors is None:
        return _EXACT
    variance = dict(zip(PARAMETERS, np.diag(errors.covariance), strict=True))
    gain_force, gain_torque, turn = (
        max(value for name, value in variance.items() if name.startswith(group))
        for group in ("gain_f", "gain_t", "clamp_orientation")
    )
    return max(
        _EXACT, math.sqrt(variance["bending_stiffness"] + gain_force + 4 * gain_torque + turn) / 2
    )


def observed(linear: Linear, wrench: Any, whitening: Any, xp: ModuleType = np) -> tuple[Any, Any]:
    """What a contact shows, less what is expected of it, and the derivatives of that by the
    coordinates: the whitened wrench, s₁ = 1 and k² = ½. `xp` is NumPy or its JAX counterpart.
    """
    value, slope = linear.value, linear.slope
    residual = (whitening @ (wrench - value.wrench)[..., None])[..., 0]
    short = 1 - linear.x[..., ARC_LENGTH, None]
    of_short = xp.zeros_like(slope.incidence) + np.eye(COORDINATES)[ARC_LENGTH]
    return (
        xp.concatenate([residual, short, 0.5 - value.incidence[..., None]], axis=-1),
        xp.concatenate(
            [
                whitening @ slope.wrench,
                of_short[..., None, :],
                slope.incidence[..., None, :],
            ],
            axis=-2,
        ),
    )


def entries(
    before: Codes,
    labels: Labels,
    x: Float[np.ndarray, "n coordinates"],
    rates: Rates,
    bend: Rates = _BEND,
    arc_length_variance: float = ARC_LENGTH_SPREAD**2,
) -> Entry:
    """How states enter samples after those of phase `before`: at rest where there is no contact, at
    the tip in tip contact, with new rates where a contact begins or breaks.
    """
    phase, link, share, _ = labels
    place, speed, spread = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    keep_place, keep_speed, faster = np.ones_like(x), np.ones_like(x), np.zeros_like(x)
    free, tip = phase == FREE, phase == TIP
    onset, anew = ~free & (before == FREE), ~free & (link == JUMP)
    changed = ~free & ~onset & (phase != before) & (link == KINK)
    new_rates = onset | (~free & (link > GO_ON) & ~changed)
    keep_speed[new_rates], faster[new_rates] = 0, rates**2
    faster[changed] = (bend * rates) ** 2
    keep_place[anew], spread[anew, :LOADS] = 0, _LOAD_SPREAD**2
    place[anew, :TILT] = x[anew, :TILT]
    spread[onset | anew, TILT] = TILT_SPREAD**2
    # A contact that begins with the flank begins anywhere on the rod.
    flank = (onset | anew) & ~tip
    keep_place[flank, ARC_LENGTH], spread[flank, ARC_LENGTH] = 0, arc_length_variance
    place[flank, ARC_LENGTH] = x[flank, ARC_LENGTH]
    for part in (keep_place, keep_speed, spread, faster):
        part[tip, ARC_LENGTH] = part[free] = 0
    place[free], place[tip, ARC_LENGTH] = AT_REST, 1
    drift = np.zeros((len(phase), WRENCH))
    active = np.where(free, 0.0, share)[:, None] * np.ones(COORDINATES)
    active[tip, ARC_LENGTH] = 0
    return Entry(
        np.hstack([keep_place, keep_speed, 1 + drift]),
        np.hstack([place, speed, drift]),
        np.hstack([spread, faster, drift]),
        active,
    )


def steps_of(fit: Fit) -> Step:
    """The model linearised about the coordinates of a fit."""
    series, labels, x = fit.series, fit.labels, fit.linear.x
    phase, count = labels.phase, len(labels.phase)
    # Without contact, or without a rod of such coordinates, nothing depends on them.
    shows = series.sound & fit.linear.exists
    nothing = jax.tree.map(lambda part: np.zeros_like(part[0]), fit.linear)
    linear = chosen(shows & (phase != FREE), fit.linear, nothing)
    residual, slope = observed(linear, series.wrench, series.whitening)
    variance = np.full((count, ROWS), np.inf)
    variance[shows, :WRENCH] = 1 / fit.weight[shows, None]
    # Where tangential contact passes over into tip contact, the arc length is the rod's.
    tangential = phase == TANGENTIAL
    arrives = tangential[:-1] & (phase[1:] == TIP) & (labels.link[1:] != JUMP)
    variance[:-1][arrives, WRENCH] = _PINNED
    contact = labels.contact
    within = (
        _FRICTION**2 * np.bincount(contact, tangential)[contact] / _UNRELATED
        if fit.incidence_spread is None
        else np.full(count, fit.incidence_spread**2)
    )
    square = tangential & shows
    variance[square, WRENCH + 1] = within[square]
    before = np.concatenate([[FREE], phase[:-1]])
    return Step(
        entries(before, labels, x, fit.rates),
        np.diff(series.time, prepend=series.time[0]),
        labels.pace,
        residual + np.einsum("nij,nj->ni", slope, linear.x),
        slope,
        variance,
    )
