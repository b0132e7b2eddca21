"""The electronics' low-pass filter and delay."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vibrissa.geometry.checks import not_negative, positive

_NEXT_TO_NONE = 1e-12


@dataclass(frozen=True)
class LowPass:
    """A Butterworth filter of first or second order behind a pure delay.

    Attributes
    ----------
    cutoff
        Frequency [Hz] at which the power has halved; infinite for a delay alone.
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
        """Time [s] by which a slow signal comes late: the delay, and the filter's group delay at
        zero frequency.
        """
        return self.delay + (1 if self.order == 1 else math.sqrt(2)) / (2 * math.pi * self.cutoff)

    def applied(
        self, time: Float[np.ndarray, "n"], signal: Float[np.ndarray, "n k"]
    ) -> Float[np.ndarray, "n k"]:
        """Return the filtered signal on its own stamps, exact for a signal that is linear between
        them and was constant before the first.

        The state equation x' = A x + b u is solved over each step by one matrix exponential,
        whatever the step's length (K. J. Åström, B. Wittenmark, "Computer-Controlled Systems", 3rd
        ed. 1997, section 2.3; for a linear signal, the first-order hold).
        """
        late = signal
        if self.delay:
            late = np.stack(
                [np.interp(time - self.delay, time, column) for column in signal.T], axis=1
            )
        if self.cutoff == math.inf:
            return late
        return self._filtered(time, late)

    def _filtered(
        self, time: Float[np.ndarray, "n"], signal: Float[np.ndarray, "n k"]
    ) -> Float[np.ndarray, "n k"]:
        from scipy.linalg import expm  # noqa: PLC0415

        rate, order = 2 * math.pi * self.cutoff, self.order
        steps, which = np.unique(np.round(np.diff(time), 12), return_inverse=True)
        # State, signal, and the signal's slope: their joint propagator over a step.
        system = np.zeros((order + 2, order + 2))
        system[0, :2] = (-rate, rate) if order == 1 else (0, 1)
        if order == 2:
            system[1, :3] = (-(rate**2), -math.sqrt(2) * rate, rate**2)
        system[order, order + 1] = 1
        propagators = expm(steps[:, None, None] * system)
        state = np.zeros((order, signal.shape[1]))
        state[0] = signal[0]
        filtered = np.empty_like(signal)
        filtered[0] = signal[0]
        slopes = np.diff(signal, axis=0) / np.maximum(np.diff(time), _NEXT_TO_NONE)[:, None]
        for row, kind in enumerate(which):
            matrix = propagators[kind]
            state = (
                matrix[:order, :order] @ state
                + np.outer(matrix[:order, order], signal[row])
                + np.outer(matrix[:order, order + 1], slopes[row])
            )
            filtered[row + 1] = state[0]
        return filtered
