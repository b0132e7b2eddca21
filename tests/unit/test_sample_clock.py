"""Stamps: the truth is known here, delays and the drift of the sensor's clock are made up."""

import numpy as np
import pytest

from vibrissa.live.clock import RateWatch, SampleClock, epoch_offset


@pytest.mark.parametrize("drift", [-1e-4, 0.0, 1e-4])
@pytest.mark.parametrize("rate", [250.0, 7000.0])
def test_stamps_are_even_though_arrivals_are_not(drift: float, rate: float) -> None:
    """Delays of 0.2 ms and more, 0.5 ms on average and 20 ms now and then: stamps are the true
    times and the least delay, to 0.2 ms.
    """
    rng = np.random.default_rng(3)
    count = round(20 * rate)
    truth = 5_000_000_000 + np.arange(count) / rate * (1 + drift) * 1e9
    delay = 2e5 + rng.exponential(3e5, count) + (rng.random(count) < 0.01) * 2e7
    arrival = np.maximum.accumulate(truth + delay).astype(np.int64)
    own = np.round(np.arange(count) / rate * 1e9).astype(np.int64)
    clock = SampleClock()
    stamp = np.concatenate(
        [
            clock.stamps(own[start : start + 17], arrival[start : start + 17])
            for start in range(0, count, 17)
        ]
    )
    assert np.all(np.diff(stamp) > 0)
    error = (stamp - truth)[count // 10 :]
    assert np.std(arrival - truth) > 4e5
    assert np.abs(error - 2e5).max() < 2e5


def test_after_a_pause_stamps_follow_at_once() -> None:
    clock = SampleClock()
    period = 4_000_000
    first = np.arange(100) * period
    clock.stamps(first, first + 1_000_000)
    later = np.arange(100, 200) * period
    stamp = clock.stamps(later, later + 3_000_000_000)
    assert np.array_equal(stamp, later + 3_000_000_000)
    back = np.arange(200, 300) * period
    stamp = clock.stamps(back, back + 1_000_000)
    assert np.all(np.diff(stamp) > 0)
    assert stamp[0] > later[-1] + 3_000_000_000


def test_the_epoch() -> None:
    import time

    assert abs(time.monotonic_ns() + epoch_offset() - time.time_ns()) < 50_000_000


def watched(
    true_period: float, nominal: float, seconds: float, delay: np.ndarray | float = 1e5
) -> list[float]:
    """Factors that the watch gives, the period mended by each."""
    count = round(seconds * 1e9 / true_period)
    arrival = (np.arange(count) * true_period + delay).astype(np.int64)
    watch, period, start, begun, factors = RateWatch(), nominal, 0, 0.0, []
    for first in range(0, count, 5):
        number = np.arange(first, min(first + 5, count))
        own = (begun + (number - start) * period).astype(np.int64)
        factor = watch.factor(own, arrival[number])
        if factor is not None:
            start, begun, period = first, float(own[0]), period * factor
            factors.append(period)
    return factors


@pytest.mark.parametrize("nominal", [1e6 / 7, 2.5e5, 7e5, 1.5e6, 4e6, 1e7])
def test_another_rate_is_found(nominal: float) -> None:
    """A thousand a second, whatever the setup says; found once, to half a percent."""
    found = watched(1e6, nominal, 5)
    assert len(found) == 1
    assert found[0] == pytest.approx(1e6, rel=5e-3)


@pytest.mark.parametrize("share", [0.12, 0.03, 0.005, -0.08, -0.02, -0.004])
def test_a_rate_that_is_nearly_right(share: float) -> None:
    """Delays of 0.3 ms on average: found to 0.1 %, the sooner the more it is off, before stamps are
    0.1 s late.
    """
    delay = np.random.default_rng(1).exponential(3e5, 20_000) + 1e5
    found = watched(1e6, 1e6 * (1 - share), 20, delay)
    assert len(found) == 1
    assert found[0] == pytest.approx(1e6, rel=1e-3)


def test_a_sender_that_stalls_has_no_other_rate() -> None:
    """For 0.4 s nothing comes, then all that is due at once; or delays of up to 0.15 s all the
    time.
    """
    time = np.arange(5000) * 1e6
    stalled = np.where((time > 1.4e9) & (time < 1.8e9), 1.8e9 - time, 1e5)
    assert watched(1e6, 1.0001e6, 5, stalled) == []
    jittered = np.maximum.accumulate(time + np.random.default_rng(0).exponential(3e7, 5000)) - time
    assert watched(1e6, 0.9999e6, 5, jittered) == []
