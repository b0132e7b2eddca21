"""Recordings of an independent dynamics engine, smoothed, against its own contacts and side by side
with a filter of the wrench.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.signal import savgol_filter
from scipy.stats import chi2

import vibrissa as vb


class Smoothed(NamedTuple):
    """One recording, smoothed and filtered; what is true of it."""

    smooth: vb.Reconstruction
    filtered: vb.Reconstruction
    point: np.ndarray
    core: np.ndarray
    """Rows in contact, without the first and last 5 %."""
    span: tuple[float, float]

    def error(self, found: vb.Reconstruction) -> np.ndarray:
        """Of the contact points in the core, in millimetres."""
        return 1e3 * np.linalg.norm(found.point[self.core] - self.point[self.core], axis=1)


@pytest.fixture(scope="module", params=["frictionless/trail_y-0.20", "friction_0.25/trail_y+0.10"])
def recorded(request: pytest.FixtureRequest, sphere_60mm: Path) -> Smoothed:
    setup = vb.load_setup(sphere_60mm / "setup.toml")
    given = vb.read_recording(sphere_60mm / f"{request.param}.csv", setup)
    truth = np.genfromtxt(sphere_60mm / f"{request.param}.truth.csv", delimiter=",", names=True)
    rows = np.flatnonzero(truth["in_contact"] == 1)
    cut = len(rows) // 20
    # Order 2 over 0.4 s at 250 Hz.
    force, moment = (savgol_filter(part, 101, 2, axis=0) for part in (given.force, given.moment))
    return Smoothed(
        vb.smooth(vb.reconstruct(setup.rod, given)),
        vb.reconstruct(setup.rod, vb.Reactions(given.trail, force, moment)),
        np.stack([truth[axis] for axis in "xyz"], axis=1),
        rows[cut:-cut],
        (truth["time"][rows[0]] - 2e-3, truth["time"][rows[-1]] + 2e-3),
    )


def test_smoothed_points_are_within_the_stated_figures(recorded: Smoothed) -> None:
    error = recorded.error(recorded.smooth)
    assert np.median(error) <= 0.12
    assert np.quantile(error, 0.95) <= 0.6


def test_smoothing_beats_filtering_the_wrench(recorded: Smoothed) -> None:
    smooth, filtered = recorded.error(recorded.smooth), recorded.error(recorded.filtered)
    assert np.median(smooth) < np.nanmedian(filtered)
    assert np.quantile(smooth, 0.95) < np.nanquantile(filtered, 0.95)


def test_the_ellipsoids_hold_the_true_points(recorded: Smoothed) -> None:
    """Errors of neighbouring points are nearly the same, so that one recording counts as a dozen
    independent errors.
    """
    assert recorded.smooth.covariance is not None
    error = recorded.smooth.point[recorded.core] - recorded.point[recorded.core]
    distance = np.einsum(
        "ni,nij,nj->n", error, np.linalg.inv(recorded.smooth.covariance[recorded.core]), error
    )
    assert np.mean(distance < chi2.isf(0.05, 3)) >= 0.9


def test_start_and_end_are_found_to_a_sample(recorded: Smoothed) -> None:
    assert recorded.smooth.smoothing is not None
    (touch,) = recorded.smooth.smoothing[0].touches
    for name, true in zip(("start", "end"), recorded.span, strict=True):
        # The truth is known to the frame of 4 ms in which contact was first seen.
        assert abs(getattr(touch, name) - true) < 4 * np.hypot(
            getattr(touch, f"{name}_deviation"), 4e-3 / np.sqrt(12)
        )
        assert getattr(touch, f"{name}_limit") < getattr(touch, f"{name}_deviation") < 2e-3


def test_only_the_rod_s_jump_to_the_other_side_is_a_jump(recorded: Smoothed) -> None:
    assert recorded.smooth.smoothing is not None
    (touch,) = recorded.smooth.smoothing[0].touches
    time = recorded.smooth.reactions.time
    assert time is not None
    jumps = time[list(touch.jumps)]
    assert np.all(np.abs(jumps - 5.75) < 0.1)
    assert len(touch.changes) == 2
