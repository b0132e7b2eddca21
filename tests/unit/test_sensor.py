"""From a raw log to support reactions: what a sensor that carries the clamp shows of one contact
force, and back.
"""

import copy
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vibrissa.sensor import Noise, RawRecording, Response, Sensor, TarePolicy

N = 30
MOUNT, CLAMP = Rotation.from_rotvec([0.3, -1.0, 0.4]), np.array([0.01, -0.02, 0.025])
POINT = (0.004, 0.001, -0.003)
OFFSET_FORCE, OFFSET_TORQUE = np.array([0.3, -0.1, 1.9]), np.array([2e-3, -4e-3, 7e-4])


class Bench:
    """A sensor moving through space, its clamp pushed by forces at points of the world."""

    def __init__(self, count: int = N, *, turning: bool = True) -> None:
        rng = np.random.default_rng(11)
        self.time = 0.1 * np.arange(count)
        turn = np.linspace(0, 1, count)[:, None] if turning else np.zeros((count, 1))
        self.pose = Rotation.from_rotvec([0.5, 0.2, -0.1] + turn * [1.0, -0.5, 0.3])
        self.position = rng.normal(size=(count, 3))
        self.force = rng.normal(size=(count, 3))
        self.at = self.position + rng.normal(scale=0.05, size=(count, 3))
        self.clamp = self.position + self.pose.apply(CLAMP)

    def sensor(self, **options: object) -> Sensor:
        """The sensor of this bench."""
        return Sensor(
            CLAMP, MOUNT.as_quat(), **({"wrench": "on_sensor", "wrench_point": POINT} | options)
        )

    def raw(self, *, wrench: str = "on_sensor", wrench_frame: str = "sensor") -> RawRecording:
        """What it logs: the contact's wrench about the wrench point, row by row, in the axes and
        with the sign asked for.
        """
        rows = []
        for i, pose in enumerate(self.pose):
            about = self.position[i] + pose.apply(POINT)
            force, torque = self.force[i], np.cross(self.at[i] - about, self.force[i])
            if wrench == "on_rod":
                force, torque = -force, -torque
            if wrench_frame == "sensor":
                force, torque = pose.inv().apply(force), pose.inv().apply(torque)
            rows.append(np.concatenate([force, torque]))
        wrench_rows = np.array(rows)
        return RawRecording(
            self.time, self.position, self.pose.as_quat(), wrench_rows[:, :3], wrench_rows[:, 3:]
        )


@pytest.mark.parametrize("wrench_frame", ["sensor", "world"])
@pytest.mark.parametrize("wrench", ["on_sensor", "on_rod"])
def test_reactions_balance_the_contact_force_about_the_clamp(
    wrench: str, wrench_frame: str
) -> None:
    bench = Bench()
    raw = bench.raw(wrench=wrench, wrench_frame=wrench_frame)
    found = bench.sensor(wrench=wrench, wrench_frame=wrench_frame).reactions(raw)
    np.testing.assert_allclose(found.force, -bench.force, rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        found.moment, -np.cross(bench.at - bench.clamp, bench.force), rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(found.trail.position, bench.clamp, rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        found.trail.axis, (bench.pose * MOUNT).apply([0, 0, 1]), rtol=0, atol=1e-14
    )
    np.testing.assert_array_equal(found.time, bench.time)


def test_taking_one_sign_for_the_other_turns_the_reactions_round() -> None:
    bench = Bench()
    found = bench.sensor(wrench="on_rod").reactions(bench.raw())
    np.testing.assert_allclose(found.force, bench.force, rtol=0, atol=1e-14)


GAIN = (1.1, 0.9, 1.05, 0.8, 1.2, 0.95)


@pytest.mark.parametrize("wrench_frame", ["sensor", "world"])
def test_gain_is_that_of_the_sensor_s_own_channels(wrench_frame: str) -> None:
    """Readings in the sensor's axes grow by it, whatever axes they are logged in; taking it off
    gives the reactions back.
    """
    bench = Bench()
    true, uneven = (
        bench.sensor(wrench_frame=wrench_frame, **options) for options in ({}, {"gain": GAIN})
    )
    raw = bench.raw(wrench_frame=wrench_frame)
    reactions = true.reactions(raw)
    read = uneven.measure(reactions, np.random.default_rng(0))
    own = [
        part if wrench_frame == "sensor" else bench.pose.inv().apply(part)
        for part in (read.force, read.torque, raw.force, raw.torque)
    ]
    np.testing.assert_allclose(own[0], own[2] * GAIN[:3], rtol=0, atol=1e-14)
    np.testing.assert_allclose(own[1], own[3] * GAIN[3:], rtol=0, atol=1e-14)
    back = uneven.reactions(read)
    np.testing.assert_allclose(back.force, reactions.force, rtol=0, atol=1e-13)
    np.testing.assert_allclose(back.moment, reactions.moment, rtol=0, atol=1e-13)


@pytest.mark.parametrize("seconds", [0.35, 0.4, 0.41])
def test_the_mean_of_the_leading_time_is_taken_off(seconds: float) -> None:
    bench = Bench()
    count = {0.35: 4, 0.4: 4, 0.41: 5}[seconds]
    bench.force[:count] = 0
    raw = bench.raw()
    shifted = RawRecording(
        raw.time,
        raw.position,
        raw.orientation,
        raw.force + OFFSET_FORCE,
        raw.torque + OFFSET_TORQUE,
    )
    found = bench.sensor(tare_seconds=seconds).reactions(shifted)
    np.testing.assert_allclose(found.force, -bench.force, rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        found.moment, -np.cross(bench.at - bench.clamp, bench.force), rtol=0, atol=1e-13
    )


@pytest.mark.parametrize(("seconds", "count"), [(0.05, 1), (100.0, N)])
def test_a_tare_window_must_fit(seconds: float, count: int) -> None:
    bench = Bench()
    with pytest.raises(
        ValueError,
        match=rf"^tare_seconds = {seconds}: {count} of {N} samples lie within it; allowed",
    ):
        bench.sensor(tare_seconds=seconds).reactions(bench.raw())


def noisy(raw: RawRecording, sensor: Sensor, rng: np.random.Generator) -> RawRecording:
    """The same with the sensor's noise, rounded to its resolution."""

    def read(value: np.ndarray, noise: float | None, step: float) -> np.ndarray:
        return step * np.round((value + rng.normal(scale=noise, size=value.shape)) / step)

    force = read(raw.force, sensor.force_noise, sensor.force_resolution)
    torque = read(raw.torque, sensor.torque_noise, sensor.torque_resolution)
    return RawRecording(raw.time, raw.position, raw.orientation, force, torque)


NOISE = {
    "force_noise": 2e-3,
    "torque_noise": 4e-5,
    "force_resolution": 2e-3,
    "torque_resolution": 4e-5,
}


def test_covariance_is_that_of_many_recordings() -> None:
    """Noise, resolution, lever arm and the tare's own error, at a pose turned against the world."""
    bench = Bench(count=4)
    bench.force[:3] = 0
    sensor = bench.sensor(tare_seconds=0.25, **NOISE)
    raw, rng = bench.raw(), np.random.default_rng(8)
    samples = np.empty((1500, 6))
    for sample in samples:
        found = sensor.reactions(noisy(raw, sensor, rng))
        sample[:] = np.concatenate([found.force[3], found.moment[3]])
    assert found.covariance is not None
    stated = found.covariance if found.covariance.ndim == 2 else found.covariance[3]
    # In units of the stated deviations the empirical covariance is the identity, within 4 of its
    # own deviations.
    root = np.linalg.inv(np.linalg.cholesky(stated))
    np.testing.assert_allclose(
        root @ np.cov(samples.T) @ root.T, np.eye(6), rtol=0, atol=4 * np.sqrt(2 / 1500)
    )


@pytest.mark.parametrize(
    "gain", [(1.0,) * 6, (1.1, 0.9, 1.05, 0.8, 1.2, 0.95)], ids=["even", "uneven"]
)
@pytest.mark.parametrize("wrench_frame", ["sensor", "world"])
@pytest.mark.parametrize("turning", [True, False])
def test_covariance_is_carried_by_the_map_from_readings_to_reactions(
    wrench_frame: str, gain: tuple[float, ...], *, turning: bool
) -> None:
    """The six readings of each row, moved one by one, move the reactions by the columns of a
    Jacobian.
    """
    bench = Bench(turning=turning)
    sensor = bench.sensor(wrench_frame=wrench_frame, force_noise=2e-3, torque_noise=4e-5, gain=gain)
    raw = bench.raw(wrench_frame=wrench_frame)
    still = sensor.reactions(raw)
    columns = []
    for axis in range(6):
        push = np.zeros(6)
        push[axis] = 1
        moved = RawRecording(
            raw.time, raw.position, raw.orientation, raw.force + push[:3], raw.torque + push[3:]
        )
        found = sensor.reactions(moved)
        columns.append(
            np.concatenate([found.force - still.force, found.moment - still.moment], axis=1)
        )
    jacobian = np.stack(columns, axis=-1)
    expected = jacobian @ np.diag([4e-6] * 3 + [1.6e-9] * 3) @ np.swapaxes(jacobian, 1, 2)
    assert still.covariance is not None
    np.testing.assert_allclose(
        np.broadcast_to(still.covariance, (N, 6, 6)), expected, rtol=1e-9, atol=1e-16
    )


def test_without_noise_there_is_no_covariance_and_with_it_the_robot_has_one() -> None:
    bench = Bench()
    assert bench.sensor().reactions(bench.raw()).covariance is None
    found = bench.sensor(force_noise=1e-3, torque_noise=1e-5, position_noise=2e-5).reactions(
        bench.raw()
    )
    np.testing.assert_allclose(found.position_covariance, 4e-10 * np.eye(3))


BAD = {
    "sign": ({"wrench": "on_wire"}, "wrench = 'on_wire'; allowed are on_sensor and on_rod"),
    "frame": ({"wrench_frame": "clamp"}, "wrench_frame = 'clamp'; allowed are sensor and world"),
    "tare": (
        {"tare_seconds": -0.5},
        "tare_seconds = -0.5; allowed is a finite number of at least 0",
    ),
    "noise": (
        {"force_noise": -1.0, "torque_noise": 1.0},
        "force_noise = -1.0; allowed is a finite number",
    ),
    "no noise": (
        {"force_noise": 0.0, "torque_noise": 1.0},
        "force_noise = 0.0; allowed is a finite number greater than 0",
    ),
    "torque noise": (
        {"force_noise": 1.0, "torque_noise": np.inf},
        "torque_noise = inf; allowed is a finite number",
    ),
    "resolution": (
        {"force_resolution": np.nan},
        "force_resolution = nan; allowed is a finite number of at least 0",
    ),
    "position noise": (
        {"position_noise": -1e-5},
        "position_noise = -1e-05; allowed is a finite number of at least 0",
    ),
    "one noise": (
        {"force_noise": 1.0},
        "force_noise and torque_noise: one is given without the other; allowed are both",
    ),
    "clamp": (
        {"clamp_position": np.array([0, np.nan, 0])},
        "clamp_position[1] = nan; allowed are finite numbers",
    ),
    "turn": (
        {"clamp_orientation": np.zeros(4)},
        "clamp_orientation = [0.0, 0.0, 0.0, 0.0] has zero norm; allowed is any",
    ),
    "gain": (
        {"gain": (1, 1, 1, 1, 0, 1)},
        "gain = (1, 1, 1, 1, 0, 1); allowed are 6 finite numbers greater than 0",
    ),
    "gains": ({"gain": (1.0, 1.0)}, "gain has shape (2,); allowed is (6,)"),
    "turns": (
        {"clamp_orientation": np.ones((2, 4))},
        "clamp_orientation has shape (2, 4); allowed is (4,)",
    ),
    "point": (
        {"wrench_point": (0.0, np.nan, 0.0)},
        "wrench_point[1] = nan; allowed are finite numbers",
    ),
}


@pytest.mark.usefixtures("no_shape_checks")
@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_named(what: str) -> None:
    options, message = BAD[what]
    good = {"clamp_position": CLAMP, "clamp_orientation": MOUNT.as_quat(), "wrench": "on_sensor"}
    with pytest.raises(ValueError, match=re.escape(message)):
        Sensor(**(good | options))


def test_figures_are_given_by_their_own_names_or_in_parts() -> None:
    flat = Sensor(CLAMP, MOUNT.as_quat(), "on_rod", force_noise=1e-3, torque_noise=2e-5, gain=GAIN)
    parts = Sensor(
        CLAMP,
        MOUNT.as_quat(),
        "on_rod",
        noise=Noise(force_noise=1e-3, torque_noise=2e-5),
        response=Response(gain=GAIN),
        tare_policy=TarePolicy(tare_seconds=None),
    )
    assert (flat.noise, flat.response.gain) == (parts.noise, parts.response.gain)
    assert (parts.tare_seconds, flat.tare_seconds, parts.force_noise) == (None, 0.0, 1e-3)
    for changed in (replace(parts, tare_seconds=0.5), parts.updated(tare_seconds=0.5)):
        assert changed.tare_policy == TarePolicy(tare_seconds=0.5)
        assert changed.noise == parts.noise
    assert copy.copy(parts).noise == parts.noise
    assert pickle.loads(pickle.dumps(parts)).gain == GAIN


def test_what_a_sensor_does_not_have_is_named() -> None:
    sensor = Sensor(CLAMP, MOUNT.as_quat(), "on_rod")
    with pytest.raises(TypeError, match="Sensor has no force_nose; allowed are its attributes"):
        Sensor(CLAMP, MOUNT.as_quat(), "on_rod", force_nose=1e-3)
    with pytest.raises(AttributeError, match="Sensor has no attribute 'force_nose'"):
        _ = sensor.force_nose
