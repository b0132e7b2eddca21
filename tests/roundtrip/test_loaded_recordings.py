"""Recordings of a heavy rod: its weight stays in the reactions when the sensor's zero is taken."""

import logging
from functools import cache
from pathlib import Path

import jax
import numpy as np
import pytest

import vibrissa as vb
from vibrissa.io.recordings.write import COLUMNS
from vibrissa.live import Callback, ConstantPose, Processor, ReplaySource, stream
from vibrissa.sensor import RawRecording

LENGTH, RATE, REST, COUNT = 0.05, 100.0, 100, 600
ROD = vb.Rod.cylinder(
    length=LENGTH, radius=0.1e-3, youngs_modulus=6e9, density=7000.0, poisson_ratio=0.3
).loaded(vb.Loads(gravity=(0, 0, -9.81)))
BALL = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
SENSOR = vb.Sensor(
    np.array([0.0, 0.0, 0.025]),
    np.array([0.0, 0.0, 0.0, 1.0]),
    "on_sensor",
    tare_seconds=None,
    force_noise=2e-3 * ROD.force_scale,
    torque_noise=8e-4 * ROD.moment_scale,
)


@cache
def swept(turning: float = 0.0) -> tuple[vb.Scan, vb.Reactions]:
    """A second at rest, then a sweep along −x, while the inclined clamp turns by some angle."""
    way = np.maximum(np.arange(REST + COUNT) - REST, 0) / RATE
    position = np.array([0.07, 0.012, 0.0]) - 0.02 * way[:, None] * [1, 0, 0]
    angle = turning * way / way[-1]
    turned = np.column_stack([0.05 + angle, -0.05 - angle, 0 * way + 0.02, 0 * way + 1.0])
    scan = vb.scan(ROD, BALL, vb.Trail(position, turned))
    reactions = scan.reactions
    time = np.arange(len(way)) / RATE
    return scan, vb.Reactions(scan.trail, reactions.force, reactions.moment, time=time)


def measured() -> RawRecording:
    _, true = swept()
    rng = np.random.default_rng(2)
    return SENSOR.measure(true, rng, force_tare=(0.3, -0.2, 0.5), torque_tare=(4e-3, 1e-3, -2e-3))


def errors(found: vb.Reconstruction, scan: vb.Scan) -> np.ndarray:
    both = np.flatnonzero(scan.in_contact & found.in_contact)
    assert len(both) > 0.9 * np.count_nonzero(scan.in_contact)
    return np.linalg.norm(found.point[both] - scan.point[both], axis=1)


def test_streamed(caplog: pytest.LogCaptureFixture) -> None:
    """Free, lightly and firmly touching: whatever they need was compiled before. First in this file,
    so that no other test has compiled it.
    """
    scan, _ = swept()
    rows: list[vb.Reconstruction] = []
    processor = Processor(ROD, SENSOR, ConstantPose())
    processor.warm_up()
    with jax.log_compiles(), caplog.at_level(logging.WARNING, logger="jax"):
        stream(ReplaySource(measured()), processor, [Callback(lambda _, row: rows.append(row))])
    assert [text for text in caplog.messages if text.startswith("Compiling")] == []
    touching = np.concatenate([row.in_contact for row in rows])
    points = np.concatenate([row.point for row in rows])
    both = scan.in_contact & touching
    assert np.mean(touching[:REST]) < 0.02
    assert np.count_nonzero(both) > 0.9 * np.count_nonzero(scan.in_contact)
    assert np.median(np.linalg.norm(points - scan.point, axis=1)[both]) < 3e-3 * LENGTH


@pytest.mark.parametrize("turning", [0.0, 0.15])
def test_weight_is_not_part_of_the_zero(turning: float) -> None:
    _, true = swept(turning)
    exact = SENSOR.updated(force_noise=None, torque_noise=None, rod=ROD, tare_seconds=0.9)
    raw = exact.measure(true, np.random.default_rng(1), force_tare=(0.3, -0.2, 0.5))
    found = exact.reactions(raw)
    np.testing.assert_allclose(found.force, true.force, rtol=0, atol=1e-9 * ROD.force_scale)
    np.testing.assert_allclose(found.moment, true.moment, rtol=0, atol=1e-9 * ROD.moment_scale)
    # Without the rod's description the weight at the start counts as the zero.
    bare = exact.updated(rod=None).reactions(raw)
    weight = 7000.0 * np.pi * 0.1e-3**2 * LENGTH * 9.81
    assert np.linalg.norm(found.force[:REST], axis=1) == pytest.approx(weight, rel=1e-6)
    assert np.abs(bare.force[:REST]).max() < 1e-6 * weight


def test_read_and_reconstructed(tmp_path: Path) -> None:
    scan, _ = swept()
    setup = vb.Setup(ROD, SENSOR)
    assert setup.sensor.rod == ROD
    # With all digits: a rod as soft as this one feels micronewtons.
    raw, path = measured(), tmp_path / "heavy.csv"
    rows = np.column_stack([raw.time, raw.position, raw.orientation, raw.force, raw.torque])
    np.savetxt(path, rows, delimiter=",", header=",".join(COLUMNS), comments="")
    reactions = vb.read_recording(path, setup)
    found = vb.reconstruct(ROD, reactions)
    assert np.mean(found.in_contact[:REST]) < 0.02
    assert np.median(errors(found, scan)) < 2e-3 * LENGTH
