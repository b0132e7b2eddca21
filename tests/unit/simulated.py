"""Recordings of a rod that is pushed at a moving point, made without a scan: rest, one contact,
rest.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.sensor import RawRecording, Sensor

RATE, REST, CONTACT = 250.0, 250, 1000
ROD = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
FORCE_TARE, TORQUE_TARE = (0.3125, -0.125, 1.9375), (2.0e-3, -4.0e-3, 7.0e-4)
MOUNT = Rotation.from_rotvec([0.3, -1.0, 0.4])


def sensor(**options: object) -> Sensor:
    """A small sensor of known noise; `options` are fields of `Sensor`."""
    plain = Sensor(
        np.array([0.001, 0.002, 0.025]),
        MOUNT.as_quat(),
        "on_sensor",
        wrench_point=(0.0, 0.0, 0.001),
        tare_seconds=None,
        force_noise=2e-3,
        torque_noise=4e-5,
        force_resolution=1.5625e-3,
        torque_resolution=7.8125e-6,
        position_noise=1e-5,
    )
    return replace(plain, **options)


def pushed(
    *, turning: float = 0.0, before: int = REST, during: int = CONTACT, after: int = REST
) -> vb.Reactions:
    """Reactions of one contact force that rises from and falls to zero while its point moves along
    the rod, with time at `RATE`.
    """
    count = before + during + after
    phase = np.clip((np.arange(count) - before) / max(during, 1), 0, 1)
    size = 0.4 * np.sin(np.pi * phase) ** 2
    direction = np.stack([np.cos(2 * phase), np.sin(2 * phase), -0.5 - phase], axis=1)
    force = size[:, None] * direction / np.linalg.norm(direction, axis=1)[:, None]
    along = np.stack(
        [0.01 * np.sin(3 * phase), 0.01 * np.cos(2 * phase), 0.04 + 0.005 * np.cos(4 * phase)],
        axis=1,
    )
    turn = Rotation.from_rotvec(turning * np.linspace(0, 1, count)[:, None] * [0.2, 1.0, -0.4])
    position = np.stack([0.04 - 0.08 * phase, 0.005 * np.ones(count), np.zeros(count)], axis=1)
    trail = vb.Trail(position, turn.as_quat())
    return vb.Reactions(
        trail,
        -turn.apply(force),
        -turn.apply(np.cross(along, force)),
        time=2.0 + np.arange(count) / RATE,
    )


def logged(of: Sensor, reactions: vb.Reactions, seed: int = 0) -> RawRecording:
    """What the sensor logs, with the tare above."""
    return of.measure(
        reactions, np.random.default_rng(seed), force_tare=FORCE_TARE, torque_tare=TORQUE_TARE
    )


def changed(
    raw: RawRecording, rows: slice | int | np.ndarray, column: int | slice, value: object
) -> RawRecording:
    """The same with the wrench's channels `column` of some rows replaced."""
    wrench = raw.wrench
    wrench[rows, column] = value
    return replace(raw, force=wrench[:, :3], torque=wrench[:, 3:])


def only(raw: RawRecording, rows: np.ndarray) -> RawRecording:
    """Some rows of a recording, in the order given."""
    return RawRecording(
        raw.time[rows], raw.position[rows], raw.orientation[rows], raw.force[rows], raw.torque[rows]
    )
