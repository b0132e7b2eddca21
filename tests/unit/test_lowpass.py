"""The filter is the solution of its differential equation, on any stamps."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vibrissa.sensor import LowPass

RNG = np.random.default_rng(5)
TIME = np.cumsum(RNG.uniform(0.001, 0.02, 80))
SIGNAL = np.cumsum(RNG.normal(size=(80, 2)), axis=0)


@pytest.mark.parametrize("order", [1, 2])
def test_a_broken_line_on_uneven_stamps_is_filtered_exactly(order: int) -> None:
    """Against an adaptive integrator."""
    rate = 2 * np.pi * 8.0
    for column in range(2):

        def slope(time: float, state: np.ndarray, column: int = column) -> list[float]:
            drive = np.interp(time, TIME, SIGNAL[:, column])
            if order == 1:
                return [rate * (drive - state[0])]
            return [state[1], rate**2 * (drive - state[0]) - np.sqrt(2) * rate * state[1]]

        start = [SIGNAL[0, column], 0.0][:order]
        value, expected = np.array(start), [start[0]]
        for first, last in pairwise(TIME):
            value = solve_ivp(
                slope, (first, last), value, rtol=1e-10, atol=1e-12, method="DOP853"
            ).y[:, -1]
            expected.append(value[0])
        found = LowPass(8.0, order).applied(TIME, SIGNAL)[:, column]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("order", [1, 2])
def test_half_the_power_passes_at_the_cutoff_and_a_ramp_comes_late_by_the_lag(order: int) -> None:
    time = np.arange(0, 4, 1e-4)
    late = LowPass(8.0, order, delay=0.013)
    wave = late.applied(time, np.stack([np.sin(2 * np.pi * 8 * time), 3 * time], axis=1))
    tail = time > 2
    assert np.sqrt(2 * np.mean(wave[tail, 0] ** 2)) == pytest.approx(np.sqrt(0.5), rel=1e-3)
    np.testing.assert_allclose(time[tail] - wave[tail, 1] / 3, late.lag, rtol=1e-9)


def test_a_delay_alone_shifts() -> None:
    late = LowPass(delay=0.05).applied(TIME, SIGNAL)
    np.testing.assert_allclose(
        late[:, 0], np.interp(TIME - 0.05, TIME, SIGNAL[:, 0]), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cutoff": 0.0}, "low_pass_cutoff = 0.0"),
        ({"cutoff": np.nan}, "low_pass_cutoff = nan"),
        ({"order": 3}, "low_pass_order = 3; allowed are 1 and 2"),
        ({"delay": -1.0}, "delay = -1.0"),
    ],
)
def test_what_is_wrong_is_named(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LowPass(**options)
