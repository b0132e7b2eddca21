"""Percentiles from bins, against those of all numbers."""

import numpy as np
import pytest

from vibrissa.live.report import Latency


def test_percentiles_are_right_to_a_percent() -> None:
    times = np.random.default_rng(0).lognormal(15, 2, 20_000).astype(np.int64)
    latency = Latency()
    assert latency.percentile(50) is None
    for part in np.array_split(times, 7):
        latency.add(part)
    for percent in (1.0, 50.0, 99.9):
        exact = np.percentile(times, percent, method="inverted_cdf") * 1e-9
        assert latency.percentile(percent) == pytest.approx(exact, rel=0.0101)
