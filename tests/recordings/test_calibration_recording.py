"""Calibration from recordings of an independent dynamics engine, whose wire and mount are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb

_TILT = np.radians(3) * np.array([0.6, -0.8, 0.0])
_MOVE = 2e-3 * np.array([0.6, 0.6, -np.sqrt(0.28)])


def _start(truth: vb.Setup, stiffness: float, length: float) -> vb.Setup:
    rod = replace(truth.rod, bending_stiffness=stiffness * truth.rod.bending_stiffness, length=length * truth.rod.length)
    orientation = Rotation.from_quat(truth.sensor.clamp_orientation) * Rotation.from_rotvec(_TILT)
    return replace(
        truth,
        rod=rod,
        sensor=replace(truth.sensor, clamp_position=truth.sensor.clamp_position + _MOVE, clamp_orientation=orientation.as_quat()),
    )


def _check(found: vb.Calibration[vb.Setup], truth: vb.Setup) -> None:
    """EI within 1 %, L within 0.5 %, the clamp within 0.2 mm and 0.3°."""
    axes = [Rotation.from_quat(setup.sensor.clamp_orientation).apply([0, 0, 1]) for setup in (found.setup, truth)]
    assert found.setup.rod.bending_stiffness == pytest.approx(truth.rod.bending_stiffness, rel=0.01)
    assert found.setup.rod.length == pytest.approx(truth.rod.length, rel=0.005)
    assert np.linalg.norm(found.setup.sensor.clamp_position - truth.sensor.clamp_position) < 0.2e-3
    assert np.degrees(np.arccos(axes[0] @ axes[1])) < 0.3


@pytest.mark.parametrize(("stiffness", "length"), [(0.8, 1.03), (1.2, 0.97), (1.2, 1.03), (0.8, 0.97)])
def test_two_trails_give_wire_and_mount(sphere_60mm: Path, stiffness: float, length: float) -> None:
    truth = vb.load_setup(sphere_60mm / "setup.toml")
    start = _start(truth, stiffness, length)
    paths = [sphere_60mm / "frictionless" / f"trail_y{name}.csv" for name in ("+0.10", "-0.20")]
    found = vb.calibrate([vb.read_recording(path, start) for path in paths], start)
    _check(found, truth)
    # The engine's wire is a chain that moves: more than noise is left over, and the intervals say so and hold the truth.
    assert found.fitness.whiteness < 1e-3
    assert found.fitness.inflation.max() > 2
    for name, value in {
        "youngs_modulus": 206e9,
        "length": 0.05,
        "clamp_position_x": 0.0,
        "clamp_position_y": 0.0,
        "clamp_position_z": 0.025,
    }.items():
        low, high = found.interval(name)
        assert low < value < high, name


def test_two_trails_that_tell_little_give_them_too(sphere_60mm: Path) -> None:
    """Far from the ball's middle on both sides; the engine's wire touches with a skin of 10 µm, which is found."""
    truth = vb.load_setup(sphere_60mm / "setup.toml")
    start = _start(truth, 0.8, 1.03)
    paths = [sphere_60mm / "frictionless" / f"trail_y{name}.csv" for name in ("+0.30", "-0.40")]
    found = vb.calibrate([vb.read_recording(path, start) for path in paths], start)
    _check(found, truth)
    low, high = found.interval("standoff")
    assert low < 10e-6 < high


def test_one_trail_with_friction_gives_them_too(sphere_60mm: Path) -> None:
    truth = vb.load_setup(sphere_60mm / "setup.toml")
    start = _start(truth, 1.2, 0.97)
    found = vb.calibrate(vb.read_recording(sphere_60mm / "friction_0.25/trail_y+0.10.csv", start), start, friction=0.25)
    _check(found, truth)


def test_contacts_reconstructed_with_the_calibrated_setup_lie_on_the_ball(sphere_60mm: Path) -> None:
    """On a trail that was not calibrated on: the wrong setup is millimetres off, the calibrated one as good as the true one."""
    truth = vb.load_setup(sphere_60mm / "setup.toml")
    start = _start(truth, 0.8, 1.03)
    folder = sphere_60mm / "frictionless"
    found = vb.calibrate([vb.read_recording(folder / f"trail_y{name}.csv", start) for name in ("+0.10", "-0.20")], start)
    off = []
    for setup in (start, found.setup, truth):
        contacts = vb.reconstruct(setup.rod, vb.read_recording(folder / "trail_y+0.30.csv", setup))
        rows = contacts.in_contact & (np.linalg.norm(contacts.reactions.force, axis=1) > 0.06)
        off.append(np.median(np.abs(truth.surface.distances(contacts.point[rows]))))
    assert off[0] > 1e-3
    assert off[1] == pytest.approx(off[2], abs=0.03e-3)
