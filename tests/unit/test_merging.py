"""Samples taken together tell the same as one by one, as long as the motion is slow against them."""

import numpy as np
import pytest

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import ROWS, SIZE, Gaussian, Step
from vibrissa.inverse.smoothing.model import (
    FREE,
    TANGENTIAL,
    TIP,
    Labels,
    group_starts,
    merged,
    spread_out,
)

COUNT, RATE = 240, 250.0
INTENSITIES = np.array([0.02, 0.02, 0.002, 1e-6, 0.02])
PHASE = np.repeat([FREE, TIP, TANGENTIAL], [80, 90, 70])


def steps() -> Step:
    """Without contact the drift alone is seen; in contact all five coordinates, which begin at
    rest.
    """
    rng = np.random.default_rng(2)
    touching = PHASE != FREE
    keep, slope = np.ones((COUNT, SIZE)), np.zeros((COUNT, ROWS, 5))
    keep[~touching, :10] = 0
    spread = np.zeros((COUNT, SIZE))
    spread[80, 5:10] = 0.3**2
    slope[touching, :6] = 40 * rng.normal(size=(6, 5))
    variance = np.full((COUNT, ROWS), np.inf)
    variance[:, :6] = 1.0
    variance[30:34] = np.inf
    target = rng.normal(size=(COUNT, ROWS))
    active = np.where(touching[:, None], np.ones(5), 0.0)
    return Step(
        keep,
        np.zeros((COUNT, SIZE)),
        spread,
        active,
        np.full(COUNT, 1 / RATE),
        np.ones(COUNT),
        target,
        slope,
        variance,
    )


def states(given: Step) -> kalman.States:
    start = Gaussian(np.zeros(SIZE), np.diag(np.repeat([0.0, 0.02], [10, 6])))
    return kalman.smoothed(given, INTENSITIES, start)


def test_nothing_changes_within_a_group() -> None:
    starts = group_starts([Labels.of(PHASE)])
    number = np.searchsorted(starts, np.arange(COUNT), side="right") - 1
    for change in (80, 170):
        assert {change - 1, change, change + 1} <= set(starts)
    size = np.bincount(number)
    assert size[number[PHASE == FREE]].max() == 32
    assert size[number[PHASE != FREE]].max() == 4


def test_groups_tell_what_their_samples_tell() -> None:
    one_by_one, starts = states(steps()), group_starts([Labels.of(PHASE)])
    groups = merged(steps(), starts)
    together = spread_out(states(groups), groups, steps(), starts)
    deviation = np.sqrt(np.maximum(np.einsum("nii->ni", one_by_one.covariance), 1e-12))
    touching = PHASE != FREE
    for entries in (slice(0, 5), slice(10, 16)):
        assert (
            np.abs(together.mean - one_by_one.mean)[touching, entries].max()
            < 0.1 * deviation[touching, entries].max()
        )
        ratio = (
            np.sqrt(np.einsum("nii->ni", together.covariance)[touching][12:, entries])
            / deviation[touching][12:, entries]
        )
        # At the ends deviations change from sample to sample, and a group has one.
        assert np.median(ratio) == pytest.approx(1, abs=0.03)
    # Over 32 samples the drift wanders by a small part of what the samples leave open.
    assert (
        np.abs(together.mean - one_by_one.mean)[~touching, 10:].max()
        < 0.5 * deviation[~touching, 10:].min()
    )


def test_groups_of_one_are_the_samples() -> None:
    given, found = steps(), states(steps())
    alone = states(merged(given, np.arange(COUNT)))
    np.testing.assert_allclose(alone.mean, found.mean, atol=1e-12)
    np.testing.assert_allclose(
        np.sum(alone.log_likelihood), np.sum(found.log_likelihood), rtol=1e-12
    )
