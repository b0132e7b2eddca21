"""Which of several labels explain the samples best."""

import numpy as np

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import RATE, SIZE
from vibrissa.inverse.smoothing.model import (
    TOGETHER,
    Fit,
    Labels,
    NoMotionError,
    Samples,
    group_starts,
    merged,
    steps_of,
)

_MOST_ROWS = 1536
"""Most samples compared, in groups of four: some seconds."""


def log_likelihoods(
    fit: Fit,
    candidates: list[Labels],
    first: int,
    stop: int,
    together: int = TOGETHER,
    bends: tuple[float, ...] = (1.0,),
) -> Samples:
    """Log-likelihoods of the rows from `first` to before `stop` under candidate labels; the drift
    before them is what earlier samples tell.

    With several `bends`, factors on the unknown rates, the values of all candidates for the first
    one come first.
    """
    first = max(first, 0)
    rows = slice(first, min(stop, first + _MOST_ROWS * together // TOGETHER))
    cut = fit.rows(rows)
    parts = [Labels(*(field[rows] for field in labels)) for labels in candidates]
    starts = group_starts(parts, together=together)
    steps = [merged(steps_of(cut.with_phases(labels)), starts) for labels in parts]
    scales = np.ones((len(bends), SIZE))
    scales[:, RATE] = np.square(bends)[:, None]
    values = kalman.log_likelihoods(
        [step._replace(spread=step.spread * scale) for scale in scales for step in steps],
        fit.intensities,
        kalman.at_rest(cut.zero),
    )
    if not np.isfinite(values).any():
        raise NoMotionError
    return np.nan_to_num(values, nan=-np.inf)
