"""The electronics' low-pass filter and delay."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm

from vibrissa.geometry.checks import not_negative, positive

# Steps that agree to a picosecond share a propagator.
_STAMP_DECIMALS = 12


@dataclass(frozen=True)
class LowPass:
    """A pure delay followed by a Butterworth filter of first or second order.

    Attributes
    ----------
    cutoff
        Half-power frequency [Hz]; infinite for a delay alone.
    order
        1 or 2.
    delay
        Dead time [s].

    Raises
    ------
    ValueError
        If the cut-off is not greater than 0, the order neither 1 nor 2, or the delay negative or
        not finite.
    """

    cutoff: float = math.inf
    order: int = 1
    delay: float = 0.0

    def __post_init__(self) -> None:
        if self.cutoff != math.inf:
            positive(self.cutoff, "low_pass_cutoff")
        if self.order not in (1, 2):
            raise ValueError(f"low_pass_order = {self.order!r}; allowed are 1 and 2")
        not_negative(self.delay, "delay")

    @property
    def lag(self) -> float:
        """Lag of a slow signal [s]: the delay plus the filter's group delay at zero frequency."""
        return self.delay + math.sqrt(self.order) / (2 * math.pi * self.cutoff)

    def applied(
        self, time: Float[np.ndarray, "n"], signal: Float[np.ndarray, "n k"]
    ) -> Float[np.ndarray, "n k"]:
        """Return the filtered signal at its own stamps, exact for a signal that is linear between
        them and was constant before the first.

        The state equation x' = A x + b u is solved over each step, of any length, by one matrix
        exponential (K. J. Åström, B. Wittenmark, "Computer-Controlled Systems", 3rd ed. 1997,
        section 2.3; for a linear signal, the first-order hold).
        """
        delayed = [np.interp(time - self.delay, time, column) for column in signal.T]
        signal = np.stack(delayed, axis=1)
        if self.cutoff == math.inf:
            return signal
        rate, order = 2 * math.pi * self.cutoff, self.order
        # State: the output and its derivatives, the signal, and the signal's slope, all propagated
        # together over a step.
        system = np.eye(order + 2, k=1)
        damping = [-math.sqrt(2) * rate] * (order - 1)
        system[order - 1] = [-(rate**order), *damping, rate**order, 0.0]
        steps, which = np.unique(np.round(np.diff(time), _STAMP_DECIMALS), return_inverse=True)
        propagators = expm(steps[:, None, None] * system)
        slopes = np.diff(signal, axis=0) / np.diff(time)[:, None]
        state = np.zeros((order + 2, signal.shape[1]))
        state[0] = signal[0]
        filtered = [signal[0]]
        for kind, level, slope in zip(which, signal, slopes, strict=False):
            state[order:] = level, slope
            state = propagators[kind] @ state
            filtered.append(state[0])
        return np.array(filtered)
