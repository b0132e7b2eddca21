"""Logs of the engine's sweeps as a real sensor would record them, with faults its setup omits."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from engine import Run, Wire

REST_SECONDS, TARE_SECONDS = 1.0, 0.9
ZERO = np.array([0.31, -0.12, 1.93, 2.1e-3, -4.0e-3, 0.7e-3])
"""Readings at rest [N, N m]."""
_FAR, _HARD, _SUDDEN = 0.5e-3, 0.02, 5.0
"""Contact has jumped if from one position of the engine to the next it moves farther than this [m],
or its force changes by more than this share of the largest, and by so many times the steps before
and after.
"""


@dataclass(frozen=True)
class Sensor:
    """The sensor as the setup states it; SI units. Noise is white."""

    rate: float = 250.0
    force_noise: float = 2e-3
    torque_noise: float = 4e-5
    force_step: float = 1 / 640
    torque_step: float = 1 / 128e3
    position_noise: float = 10e-6
    clamp: tuple[float, float, float] = (0.0, 0.0, 0.025)


@dataclass(frozen=True)
class Faults:
    """Deviations from the stated values; none by default.

    Attributes
    ----------
    modulus, radius, length
        Stated value over true one.
    turned, shifted
        Rotation vector [rad] and shift [m] of the clamp in the sensor frame from its stated pose.
    delay
        Delay of the poses [s].
    gain
        Readings over truth (6,).
    drift
        Drift of the zero per second [N, N m] (6,).
    warming, warming_seconds
        Final shift of the zero (6,), and its time constant.
    noise
        Over the stated one.
    hum, hum_hertz
        Amplitude on the channels (6,), and frequency.
    pose_noise
        Over the stated one.
    """

    modulus: float = 1.0
    radius: float = 1.0
    length: float = 1.0
    turned: tuple[float, ...] = (0.0, 0.0, 0.0)
    shifted: tuple[float, ...] = (0.0, 0.0, 0.0)
    delay: float = 0.0
    gain: tuple[float, ...] = (1.0,) * 6
    drift: tuple[float, ...] = (0.0,) * 6
    warming: tuple[float, ...] = (0.0,) * 6
    warming_seconds: float = 4.0
    noise: float = 1.0
    hum: tuple[float, ...] = (0.0,) * 6
    hum_hertz: float = 50.0
    pose_noise: float = 1.0


@dataclass(frozen=True)
class Log:
    """Rows of a recording, the truth, and the setup's text.

    Attributes
    ----------
    table
        Time, position and quaternion of the sensor, force and torque on it (n, 14); SI units.
    point
        Contact point (n, 3), world axes; NaN without contact.
    direction
        Direction of the contact force on the rod (n, 3), without friction the object's normal; NaN
        without contact.
    setup
        The setup as TOML.
    """

    table: np.ndarray
    point: np.ndarray
    direction: np.ndarray
    setup: str

    def write(self, folder: Path, name: str) -> None:
        """Write NAME.csv, NAME.toml and NAME.truth.npz."""
        folder.mkdir(parents=True, exist_ok=True)
        form = ["%.5f"] + 3 * ["%.6f"] + 4 * ["%.9f"] + 3 * ["%.6f"] + 3 * ["%.8f"]
        names = "time,px,py,pz,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz"
        np.savetxt(
            folder / f"{name}.csv", self.table, delimiter=",", header=names, comments="", fmt=form
        )
        (folder / f"{name}.toml").write_text(self.setup)
        np.savez_compressed(
            folder / f"{name}.truth.npz",
            t=self.table[:, 0],
            p=self.point,
            ic=np.isfinite(self.point[:, 0]),
        )


@dataclass(frozen=True)
class Sampled:
    """A run at the sensor's samples: time (n,), clamp (n, 3) and its rotation, wrench of the clamp
    on the rod in clamp axes (n, 6), contact (n, 3).
    """

    time: np.ndarray
    clamp: np.ndarray
    turn: Rotation
    wrench: np.ndarray
    point: np.ndarray


def logged(
    run: Run, wire: Wire, *, seconds: float, faults: Faults, seed: int, sensor: Sensor | None = None
) -> Log:
    """Log a run that takes `seconds` after a second of rest."""
    sensor, rng = sensor or Sensor(), np.random.default_rng(seed)
    true = sampled(run, seconds, sensor.rate)
    # The sensor's pose from the clamp's: the clamp is mounted with faults that the setup does not
    # know of.
    mounted, turned = np.array(sensor.clamp) + faults.shifted, Rotation.from_rotvec(faults.turned)
    turn = true.turn * turned.inv()
    place = true.clamp - turn.apply(mounted)
    force, moment = (-turned.apply(part) for part in (true.wrench[:, :3], true.wrench[:, 3:]))
    readings = np.concatenate([force, moment + np.cross(mounted, force)], axis=1) * faults.gain
    readings = _measured(readings, true.time, sensor, faults, rng)
    place, turn = _late(place, turn, true.time, faults.delay)
    place = place + faults.pose_noise * sensor.position_noise * rng.normal(size=place.shape)
    table = np.column_stack([true.time, place, turn.as_quat(canonical=True), readings])
    pushed = -true.turn.apply(true.wrench[:, :3])
    direction = np.where(
        np.isfinite(true.point),
        pushed / np.fmax(np.linalg.norm(pushed, axis=1, keepdims=True), np.finfo(float).tiny),
        np.nan,
    )
    return Log(table, true.point, direction, stated(wire, sensor, faults))


def sampled(run: Run, seconds: float, rate: float) -> Sampled:
    """Interpolate between the engine's positions; hold across jumps, where a straight line would
    pass through no equilibrium.
    """
    rows = np.flatnonzero(run.rests)
    time = (np.arange(round((REST_SECONDS + seconds) * rate)) + 0.5) / rate
    at = np.interp(
        np.clip((time - REST_SECONDS) / seconds, 0, 1) * (len(run.position) - 1),
        rows,
        np.arange(len(rows)),
    )
    run = Run(**{name: values[rows] for name, values in vars(run).items()})
    jumps = _sudden(run.point, _FAR) | _sudden(
        run.force, _HARD * np.linalg.norm(run.force, axis=1).max()
    )
    before = np.minimum(at.astype(int), len(rows) - 2)
    share = np.where(jumps[before], 0.0, at - before)[:, None]

    def between(values: np.ndarray) -> np.ndarray:
        return values[before] * (1 - share) + values[before + 1] * share

    turns = Rotation.from_quat(run.orientation)
    turn = turns[before] * Rotation.from_rotvec(
        (at - before)[:, None] * (turns[before].inv() * turns[before + 1]).as_rotvec()
    )
    clamp = (
        run.position[before] * (1 - (at - before)[:, None])
        + run.position[before + 1] * (at - before)[:, None]
    )
    still = run.twice[before] | run.twice[before + 1]
    point = np.where(still[:, None], np.nan, between(run.point))
    return Sampled(
        time, clamp, turn, between(np.concatenate([run.force, run.moment], axis=1)), point
    )


def _sudden(values: np.ndarray, far: float) -> np.ndarray:
    step = np.linalg.norm(np.diff(values, axis=0), axis=1)
    around = np.fmax(np.r_[np.nan, step[:-1]], np.r_[step[1:], np.nan])
    return (step > far) & (step > _SUDDEN * around)


def _measured(
    readings: np.ndarray, time: np.ndarray, sensor: Sensor, faults: Faults, rng: np.random.Generator
) -> np.ndarray:
    noise, step = (
        np.repeat(pair, 3)
        for pair in (
            (sensor.force_noise, sensor.torque_noise),
            (sensor.force_step, sensor.torque_step),
        )
    )
    t = time[:, None]
    zero = (
        ZERO
        + np.array(faults.drift) * t
        + np.array(faults.warming) * (1 - np.exp(-t / faults.warming_seconds))
    )
    hum = np.array(faults.hum) * np.sin(2 * np.pi * faults.hum_hertz * t + 0.4)
    values = readings + zero + hum + faults.noise * noise * rng.normal(size=readings.shape)
    return np.round(values / step) * step


def _late(
    place: np.ndarray, turn: Rotation, time: np.ndarray, delay: float
) -> tuple[np.ndarray, Rotation]:
    if not delay:
        return place, turn
    at = np.clip(time - delay, time[0], time[-1])
    moved = np.stack([np.interp(at, time, axis) for axis in place.T], axis=1)
    quaternions = np.stack(
        [np.interp(at, time, part) for part in turn.as_quat(canonical=True).T], axis=1
    )
    return moved, Rotation.from_quat(quaternions)


def stated(wire: Wire, sensor: Sensor, faults: Faults) -> str:
    """The setup as a user would have written it."""
    return f"""[rod]
kind = "cylinder"
length = {wire.length * faults.length!r}
radius = {wire.radius * faults.radius!r}
youngs_modulus = {wire.youngs_modulus * faults.modulus!r}

[sensor]
clamp_position = {list(sensor.clamp)}
clamp_orientation = [0.0, 0.0, 0.0, 1.0]
wrench = "on_sensor"
tare_seconds = {TARE_SECONDS}
force_noise = {sensor.force_noise!r}
torque_noise = {sensor.torque_noise!r}
force_resolution = {sensor.force_step!r}
torque_resolution = {sensor.torque_step!r}
position_noise = {sensor.position_noise!r}
"""
