"""Causes of error as users know them: which of the errors of a bench each may change, and sizes
that would be no surprise.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.inverse.checks.rig import (
    CURVATURE,
    DRIFT,
    ERRORS,
    GAIN,
    LENGTH,
    LOAD,
    POSITION,
    ROTATION,
    STIFFNESS,
    TAPER,
    ZERO,
    BenchErrors,
    Directions,
)

CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")
_DRIFT_SPREAD, _ZERO_SPREAD = 20.0, 10.0
"""Standard deviations before the data, in those of a sample: of what a zero may drift over a
contact, and be off by.
"""
_SPREADS = np.zeros(ERRORS)
"""Standard deviations before the data: gross mistakes are three of them. A stiffness by 30 %, a
length by 5 %, a clamp by 0.04 L and 6°, a gain by 10 %.
"""
_SPREADS[[STIFFNESS, LENGTH, TAPER]] = 0.3, 0.05, 0.3
for _where, _spread in (
    (POSITION, 0.04),
    (ROTATION, 0.1),
    (GAIN, 0.1),
    (CURVATURE, 0.3),
    (LOAD, 0.3),
):
    _SPREADS[_where] = _spread


@dataclass(frozen=True, eq=False)
class Suspect:
    """One cause of error.

    Attributes
    ----------
    name
        As users know it.
    directions
        (32, p) errors of the bench for a unit of each of its numbers.
    """

    name: str
    directions: Directions


class Tried(NamedTuple):
    """One cause, as large as explains most."""

    score: float
    """What it explains of χ², less a price for its numbers."""
    suspect: Suspect
    size: Float[np.ndarray, "p"]
    deviation: Float[np.ndarray, "p"]
    explained: float
    moved: Float[np.ndarray, "k 3"]
    """Shift of the contacts that it implies, clamp axes [L]."""

    @property
    def shift(self) -> float:
        """In the median."""
        return float(np.median(np.linalg.norm(self.moved, axis=1)))

    @property
    def largest(self) -> float:
        """Where it is largest, in a fifth of the sweep: a length shows, and matters, in tip contact
        alone.
        """
        return float(np.quantile(np.linalg.norm(self.moved, axis=1), 0.8))


def _of(name: str, *entries: int) -> Suspect:
    """Each error by itself."""
    return Suspect(name, np.eye(ERRORS)[:, list(entries)])


def _together(name: str, where: slice) -> Suspect:
    """All errors alike."""
    return Suspect(name, np.eye(ERRORS)[:, where].sum(axis=1, keepdims=True))


def _numbers(where: slice) -> range:
    return range(where.start, where.stop)


SUSPECTS = (
    _of("bending_stiffness", STIFFNESS),
    _of("length", LENGTH),
    _of("clamp_orientation", *_numbers(ROTATION)[:2]),
    _of("clamp_position", *_numbers(POSITION)),
    _together("gain", GAIN),
    _together("force_gain", slice(GAIN.start, GAIN.start + 3)),
    _together("torque_gain", slice(GAIN.start + 3, GAIN.stop)),
    _of("taper", TAPER),
    _of("rest_curvature", *_numbers(CURVATURE)),
    _of("load", *_numbers(LOAD)),
    *(
        _of(f"gain_{channel}", index)
        for channel, index in zip(CHANNELS, _numbers(GAIN), strict=True)
    ),
    *(
        _of(f"drift_{channel}", index)
        for channel, index in zip(CHANNELS, _numbers(DRIFT), strict=True)
    ),
    *(
        _of(f"zero_{channel}", index)
        for channel, index in zip(CHANNELS, _numbers(ZERO), strict=True)
    ),
)
"""In the order in which they are named where they explain as much: what is known least comes first.
"""

TELLING = 10
"""How many of them change all stretches alike: all but single channels. By these, phases are told.
"""


def spreads_of(sample: Float[np.ndarray, "6"], duration: float) -> BenchErrors:
    """Standard deviations before the data, for the noise of a sample (6), model units, and the
    contact's duration.
    """
    spreads = _SPREADS.copy()
    spreads[DRIFT], spreads[ZERO] = _DRIFT_SPREAD * sample / duration, _ZERO_SPREAD * sample
    return spreads
