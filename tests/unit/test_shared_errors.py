"""What errors of the setup do to contacts: derivatives against readings taken with other numbers,
and covariances that hold them.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import vibrissa as vb
from vibrissa.inverse.shared import sensitivities
from vibrissa.io.calibration import CalibrationTable
from vibrissa.sensor import RawRecording, Sensor
from vibrissa.tolerances import PARAMETERS, SetupErrors

ROD = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
TOLERANCES = vb.Tolerances(
    youngs_modulus=0.04,
    radius=0.01,
    length=0.4e-3,
    clamp_position=0.4e-3,
    clamp_orientation=0.01,
    gain=0.015,
    pose_delay=5e-3,
)
RATE = 100.0
SENSOR = Sensor(
    np.array([0.001, 0.002, 0.025]),
    Rotation.from_rotvec([0.3, -0.2, 0.5]).as_quat(),
    "on_sensor",
    wrench_point=(0.0, 0.001, 0.002),
    force_noise=1e-3,
    torque_noise=1e-5,
)
WHISK = vb.Trail.whisk(
    pivot=(0, 0, 0),
    axis=(0, 0, 1),
    position=(0.01, 0, 0),
    start_angle=0.2,
    stop_angle=0.5,
    count=12,
    rod_axis=(1, 0, 0),
)


@cache
def scan() -> vb.Scan:
    return vb.scan(ROD, vb.surfaces.Sphere(center=(0.042, 0.027, 0.004), radius=0.02), WHISK)


def logged(sensor: Sensor) -> RawRecording:
    """What it logs of the whisk, without noise."""
    exact = replace(sensor, force_noise=None, torque_noise=None)
    return exact.measure(
        replace(scan().reactions, time=np.arange(len(scan().kind)) / RATE), np.random.default_rng(0)
    )


def read(
    raw: RawRecording, sensor: Sensor, name: str = "length", error: float = 0.0
) -> vb.Reconstruction:
    """Contacts by a setup one of whose numbers is larger by `error`."""
    rod, delay = ROD, error if name == "pose_delay" else 0.0
    axis = {"x": 0, "y": 1, "z": 2}.get(name[-1], 0)
    if name == "bending_stiffness":
        rod = vb.Rod(ROD.length, ROD.bending_stiffness * (1 + error))
    elif name == "length":
        rod = vb.Rod(ROD.length + error, ROD.bending_stiffness)
    elif name.startswith("clamp_position"):
        sensor = replace(sensor, clamp_position=sensor.clamp_position + error * np.eye(3)[axis])
    elif name.startswith("clamp_orientation"):
        turn = Rotation.from_quat(sensor.clamp_orientation) * Rotation.from_rotvec(
            error * np.eye(3)[axis]
        )
        sensor = replace(sensor, clamp_orientation=turn.as_quat())
    elif name.startswith("gain"):
        channel = axis + 3 * ("torque" in name)
        sensor = replace(sensor, gain=tuple((1 + error * np.eye(6)[channel]).tolist()))
    if delay:
        # Poses that come late belong to what came before: the one that belongs to a wrench is
        # stamped later.
        at = np.clip(raw.time + delay, raw.time[0], raw.time[-1])
        position = np.stack([np.interp(at, raw.time, part) for part in raw.position.T], axis=1)
        raw = replace(
            raw,
            position=position,
            orientation=Slerp(raw.time, Rotation.from_quat(raw.orientation))(at).as_quat(),
        )
    return vb.reconstruct(rod, sensor.reactions(raw, tolerances=TOLERANCES))


@pytest.mark.parametrize("frame", ["sensor", "world"])
def test_derivatives_are_those_of_readings_with_other_numbers(frame: str) -> None:
    sensor = replace(SENSOR, wrench_frame=frame)
    raw = logged(sensor)
    slopes = sensitivities(read(raw, sensor))
    rows = np.flatnonzero(scan().kind[1:-1] == vb.ContactKind.TANGENTIAL) + 1
    assert len(rows) > 3
    for column, name in enumerate(PARAMETERS):
        unit = ROD.length if name == "length" or name.startswith("clamp_position") else 1.0
        step = 1e-4 * unit if name != "pose_delay" else 1e-3
        up, down = (read(raw, sensor, name, sign * step) for sign in (1, -1))
        # A delay's rate is taken over 50 ms, in which the clamp turns: a part in a thousand.
        for part, seen in (
            ("point", slopes[:, :3, column] * ROD.length / unit),
            ("normal", slopes[:, 3:, column] / unit),
        ):
            moved = (getattr(up, part) - getattr(down, part)) / (2 * step)
            scale = np.abs(moved[rows]).max()
            np.testing.assert_allclose(
                seen[rows], moved[rows], rtol=0, atol=4e-3 * scale + 1e-6, err_msg=f"{name}, {part}"
            )


def test_covariance_is_noise_and_what_is_shared() -> None:
    found = read(logged(SENSOR), SENSOR)
    assert found.shared_names == PARAMETERS
    whole = found.covariance_noise + found.shared @ np.swapaxes(found.shared, 1, 2)
    np.testing.assert_allclose(found.covariance, whole, rtol=1e-9)
    whole = found.normal_covariance_noise + found.shared_normal @ np.swapaxes(
        found.shared_normal, 1, 2
    )
    np.testing.assert_allclose(found.normal_covariance, whole, rtol=1e-9, atol=1e-18)
    alone = vb.reconstruct(ROD, SENSOR.reactions(logged(SENSOR)))
    np.testing.assert_allclose(alone.covariance, found.covariance_noise, rtol=1e-9)
    np.testing.assert_array_equal(alone.covariance, alone.covariance_noise)
    assert alone.shared.shape == (len(scan().kind), 3, 0)
    assert alone.shared_names == ()


def test_stiffness_of_modulus_and_radius() -> None:
    assert TOLERANCES.covariance[0, 0] == pytest.approx(0.04**2 + (4 * 0.01) ** 2)


def test_factor_of_errors_that_go_together() -> None:
    covariance = TOLERANCES.covariance
    covariance[0, 1] = covariance[1, 0] = -0.8 * np.sqrt(covariance[0, 0] * covariance[1, 1])
    covariance[8:11, 8:11] = 1e-4
    errors = SetupErrors(covariance, np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))
    np.testing.assert_allclose(errors.factor @ errors.factor.T, covariance, rtol=1e-12, atol=1e-18)
    # Three gains that are off by the same are one error.
    assert errors.names == tuple(
        name for name in PARAMETERS if name not in ("gain_force_y", "gain_force_z")
    )
    with pytest.raises(ValueError, match="positive semidefinite"):
        SetupErrors(-covariance, np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))


def test_a_calibration_takes_the_place_of_what_it_determined() -> None:
    estimates = {
        "youngs_modulus": {
            "unit": "Pa",
            "given": 2.0e11,
            "value": 2.1e11,
            "standard_deviation": 2.1e9,
        },
        "length": {"unit": "m", "given": 0.05, "value": 0.0502, "standard_deviation": 1e-4},
        "force_gain": {"unit": "1", "given": 1.0, "value": 1.02, "standard_deviation": 0.0102},
    }
    correlation = [[1.0, 0.7, 0.0], [0.7, 1.0, 0.0], [0.0, 0.0, 1.0]]
    table = CalibrationTable.model_construct(
        names=list(estimates), correlation=correlation, estimates=estimates
    )
    table = table.model_copy(
        update={
            "estimates": {
                name: CalibrationTable.model_fields["estimates"].annotation.__args__[1](**one)
                for name, one in estimates.items()
            }
        }
    )
    covariance = table.parameter_covariance(TOLERANCES.covariance)
    deviations = np.sqrt(np.diag(covariance))
    # The radius adds nothing to an EI that was calibrated; what was not calibrated is as stated.
    np.testing.assert_allclose(deviations[:3], [0.01, 1e-4, 0.4e-3])
    assert covariance[0, 1] == pytest.approx(0.7 * 0.01 * 1e-4)
    np.testing.assert_allclose(covariance[8:11, 8:11], 1e-4)
    np.testing.assert_allclose(deviations[11:], [0.015, 0.015, 0.015, 5e-3])


def test_expected_error_with_tolerances() -> None:
    line = vb.Trail.line(start=(0.01, 0.005, 0), stop=(-0.01, 0.005, 0), count=5)
    ball = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
    alone, whole = (
        vb.expected_error(ROD, ball, line, SENSOR, speed=0.02, tolerances=given)
        for given in (None, TOLERANCES)
    )
    np.testing.assert_allclose(whole.found.covariance_noise, alone.covariance, rtol=1e-9)
    delay = whole.found.shared[..., -1]
    # Poses that come late by one deviation are off by the way of the clamp.
    np.testing.assert_allclose(delay, np.tile([-0.02 * 5e-3, 0, 0], (5, 1)), rtol=1e-6, atol=1e-12)
    assert np.all(whole.root_mean_square > 3 * alone.root_mean_square)


def test_rounding_does_not_decide_what_moves_a_contact_at_the_tip() -> None:
    """Moments larger or smaller by 1e-12 put s₁ on either side of the tip."""
    line = vb.Trail.line(start=(0.04, 0.01, 0), stop=(-0.04, 0.01, 0), count=41)
    scan = vb.scan(ROD, vb.surfaces.Sphere(center=(0, 0, 0.065), radius=0.03), line)
    tips = scan.kind == vb.ContactKind.TIP
    assert tips.sum() > 5
    tolerated = SENSOR.setup_errors(replace(TOLERANCES, pose_delay=0.0))
    less, more = (
        vb.reconstruct(
            ROD,
            replace(
                scan.reactions,
                moment=factor * scan.reactions.moment,
                covariance=np.diag([4e-6] * 3 + [1e-9] * 3),
                setup_errors=tolerated,
                time=np.arange(len(tips)) / RATE,
            ),
        )
        for factor in (1 - 1e-12, 1 + 1e-12)
    )
    np.testing.assert_allclose(less.covariance[tips], more.covariance[tips], rtol=1e-5, atol=1e-12)
