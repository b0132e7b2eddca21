"""Calibration of rods that taper, are bent at rest or pivot, from sweeps that the forward solver
made.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from bench_files import SETUP
from calibration_bench import BALL, WIRE, sensor, swept

import vibrissa as vb
from vibrissa.io import write_calibration

_PIVOT = np.array([8.0, 12.0, 10.0]) * WIRE.moment_scale
ROD = replace(
    WIRE,
    section=vb.Section.taper(0.3),
    rest=vb.RestShape.polynomial((4.0,), 0.7),
    support=vb.Support.pivot(_PIVOT),
)
"""One for all tests: its kernels are compiled once."""


@cache
def swept_with(lower: float, every: int) -> vb.Reactions:
    """Reactions of a sweep under the ball, and at rest before it; one in so many of the samples."""
    given = swept(0.005)
    trail = vb.Trail(given.trail.position[::every] - [0, 0, lower])
    scan = vb.scan(ROD, BALL, trail)
    force, moment = (np.nan_to_num(part) for part in (scan.reactions.force, scan.reactions.moment))
    return vb.Reactions(trail, force, moment, time=given.time[::every])


def calibrated(start: vb.Rod, *free: str, lower: float = 0.0, every: int = 2) -> vb.Calibration:
    """From the log of such a sweep."""
    one = sensor()
    raw = one.measure(swept_with(lower, every), np.random.default_rng(0))
    return vb.calibrate(raw, vb.Setup(start, one, BALL), free=free)


def assert_found(found: vb.Calibration, **truth: float) -> None:
    for name, value in truth.items():
        one = found.estimates[name]
        assert one.determined, name
        assert abs(one.value - value) < 3.5 * one.deviation, name
    assert found.fitness.reduced_chi_square == pytest.approx(1, abs=0.2)
    assert found.warnings == []


def test_a_taper_is_found_with_the_stiffness(tmp_path: Path) -> None:
    """And written into the setup, where a cylinder becomes a tapered rod."""
    start = replace(
        ROD, section=vb.Section.taper(0.25), bending_stiffness=1.1 * ROD.bending_stiffness
    )
    found = calibrated(start, "youngs_modulus", "taper")
    assert_found(found, youngs_modulus=206e9, taper=0.3)
    assert found.estimates["taper"].deviation < 0.01
    rod = found.setup.rod
    tip = float(rod.radius_at(1.0))
    assert tip == pytest.approx(0.25e-3 * (1 - found.estimates["taper"].value))
    (tmp_path / "setup.toml").write_text(SETUP, encoding="utf-8")
    path = write_calibration(tmp_path / "found.toml", found, tmp_path / "setup.toml")
    loaded = vb.load_setup(path)
    assert float(loaded.rod.radius_at(1.0)) == pytest.approx(tip, rel=1e-12)
    assert loaded.rod.bending_stiffness == pytest.approx(rod.bending_stiffness, rel=1e-12)
    assert loaded.calibration is not None
    np.testing.assert_allclose(loaded.calibration.covariance(), found.covariance, rtol=1e-6)


def test_a_tip_radius_is_the_same_number() -> None:
    found = calibrated(ROD, "tip_radius")
    assert_found(found, tip_radius=0.175e-3)


def test_light_touches_of_the_tip_hardly_tell_taper_from_stiffness() -> None:
    """Which is said, and stated as wide intervals that hold the truth."""
    found = calibrated(ROD, "youngs_modulus", "taper", lower=0.018, every=1)
    assert_found(found, youngs_modulus=206e9, taper=0.3)
    assert found.estimates["youngs_modulus"].deviation > 20e9
    ((first, second, correlation),) = found.identifiability.confused
    assert (first, second) == ("youngs_modulus", "taper")
    assert correlation > 0.999
    assert "youngs_modulus and taper: hardly told apart" in found.identifiability.text[0]


def test_a_curvature_is_found_with_its_side(tmp_path: Path) -> None:
    start = replace(ROD, rest=vb.RestShape.polynomial((0.0,), 0.0))
    found = calibrated(start, "youngs_modulus", "rest_curvature", "rest_roll")
    assert_found(found, youngs_modulus=206e9, rest_curvature=4.0, rest_roll=0.7)
    (tmp_path / "setup.toml").write_text(SETUP, encoding="utf-8")
    path = write_calibration(tmp_path / "found.toml", found, tmp_path / "setup.toml")
    rods = vb.load_setup(path).rod, found.setup.rod
    points = [np.asarray(rod.rest.at(np.linspace(0, 0.05, 5))) for rod in rods]
    np.testing.assert_allclose(*points, rtol=1e-12, atol=1e-12)


def test_a_pivot_is_found_about_both_axes_that_bend_it() -> None:
    start = replace(ROD, support=vb.Support.pivot(1.2 * _PIVOT))
    found = calibrated(start, "support_stiffness")
    assert_found(found, support_stiffness_x=_PIVOT[0], support_stiffness_y=_PIVOT[1])


@pytest.mark.parametrize(
    ("rod", "free", "message"),
    [
        (WIRE, ("support_stiffness",), "needs a rod on a pivot"),
        (WIRE, ("rest_roll",), "needs 'rest_curvature'"),
        (WIRE, ("taper", "tip_radius"), "the same parameters"),
        (WIRE.curved(vb.RestShape.parabola(2.0)), ("rest_curvature",), "straight or an arc"),
        (
            vb.Rod.from_table(
                arc_length=(0, 0.02, 0.05), radius=(3e-4, 3e-4, 2e-4), youngs_modulus=2e9
            ),
            ("taper",),
            "uniform or tapers linearly",
        ),
    ],
)
def test_what_a_rod_does_not_have_cannot_be_free(
    rod: vb.Rod, free: tuple[str, ...], message: str
) -> None:
    one = sensor()
    raw = one.measure(swept(0.005), np.random.default_rng(0))
    with pytest.raises(ValueError, match=message):
        vb.calibrate(raw, vb.Setup(rod, one, BALL), free=free)
