"""What a sweep tells of a heavy wire's stiffness, weight and the sensor's zero: its weight pulls at
the sensor all the time, as a zero of the sensor does.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from calibration_bench import BALL, CLAMP, COUNT, FORCE_TARE, RATE, REST, TORQUE_TARE, TURN, sensor

import vibrissa as vb

pytestmark = pytest.mark.slow

GRAVITY = np.array([0.0, -9.81, 0.0])
WIRE = vb.Rod.cylinder(length=0.05, radius=0.1e-3, youngs_modulus=6e9, density=2000.0).loaded(
    vb.Loads(gravity=GRAVITY)
)
"""Its weight is 0.16 EI/L²; across the clamp's axis, as everywhere in this file."""
MORE = 0.1
HEAVIER = replace(WIRE, linear_density=(1 + MORE) * WIRE.linear_density)
UNIT = np.repeat([WIRE.force_scale, WIRE.moment_scale], 3)
ZERO = np.array([*FORCE_TARE, *TORQUE_TARE]) * [*3 * [WIRE.force_scale], *3 * [WIRE.moment_scale]]
TARED = 1.5
SENSOR = sensor(
    force_noise=2e-3 * WIRE.force_scale, torque_noise=8e-4 * WIRE.moment_scale, tare_seconds=TARED
)


@cache
def logged() -> vb.sensor.RawRecording:
    """A sweep under the ball, at rest before it."""
    way = np.maximum(np.arange(REST + COUNT) - REST, 0) / COUNT
    scan = vb.scan(
        WIRE, BALL, vb.Trail(np.array([0.05, 0.006, 0.0]) - 0.1 * way[:, None] * [1, 0, 0])
    )
    assert {*scan.kind[scan.in_contact]} == {vb.ContactKind.TIP, vb.ContactKind.TANGENTIAL}
    time = np.arange(len(way)) / RATE
    true = vb.Reactions(scan.trail, scan.reactions.force, scan.reactions.moment, time=time)
    return SENSOR.measure(true, np.random.default_rng(0), force_tare=ZERO[:3], torque_tare=ZERO[3:])


def calibrated(rod: vb.Rod, *free: str) -> tuple[vb.Calibration, np.ndarray]:
    """And the error of the zero that it finds [EI/L², EI/L], as a load on the rod."""
    found = vb.calibrate(logged(), vb.Setup(rod, SENSOR, BALL), free=(*free, "tare"))
    taken = SENSOR.carrying(rod).tare(logged()).offset
    return found, (found.tare[0] - (taken - ZERO)) / UNIT


def test_stiffness_and_zero_are_found_if_the_weight_is_known() -> None:
    """The zero to half the error of the tare alone: contacts tell of it too."""
    start = replace(WIRE, bending_stiffness=1.1 * WIRE.bending_stiffness)
    found, error = calibrated(start, "youngs_modulus")
    modulus, deviation = found.estimates["youngs_modulus"], found.tare_deviation[0] / UNIT
    assert abs(modulus.value - 6e9) < 3.5 * modulus.deviation < 2e-3 * 6e9
    assert np.all(abs(error) < 3.5 * deviation)
    alone = np.repeat([2e-3, 8e-4], 3) / np.sqrt(TARED * RATE)
    assert np.all(deviation < 0.7 * alone)
    assert found.fitness.reduced_chi_square == pytest.approx(1, abs=0.2)
    assert found.warnings == []


def test_a_wrong_weight_passes_for_a_zero_and_another_place_of_the_object() -> None:
    """As the clamp is not turned: the zero makes up for the weight, and the object seems to lie where
    the wire, which seems to sag by so much more, still touches it.
    """
    found, error = calibrated(HEAVIER, "youngs_modulus", "object_position")
    assert found.fitness.reduced_chi_square == pytest.approx(1, abs=0.2)
    assert found.warnings == []
    excess = MORE * WIRE.linear_density * WIRE.length * TURN.apply(GRAVITY)
    middle = CLAMP - SENSOR.wrench_point + TURN.apply([0, 0, WIRE.length / 2])
    np.testing.assert_allclose(
        error, np.array([*excess, *np.cross(middle, excess)]) / UNIT, rtol=0, atol=1e-3
    )
    sag = MORE * WIRE.linear_density * 9.81 * WIRE.length**4 / (8 * WIRE.bending_stiffness)
    assert found.estimates["object_position_y"].value == pytest.approx(-sag, rel=0.2)
    assert found.estimates["youngs_modulus"].value == pytest.approx(6e9, rel=0.01)


def test_a_wrong_weight_contradicts_an_object_whose_place_is_known() -> None:
    with pytest.warns(vb.RecordingWarning, match=r"contradict what is held: the object .* 0\.1"):
        found, _ = calibrated(HEAVIER, "youngs_modulus")
    assert found.fitness.reduced_chi_square > 3
