"""Sweeps under a ball as a sensor would log them, for tests of smoothing."""

from typing import NamedTuple

import numpy as np

import vibrissa as vb
from vibrissa.sensor import RawRecording

WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
BALL = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
SENSOR = vb.Sensor(
    np.array([0.0, 0.0, 0.025]),
    np.array([0.0, 0.0, 0.0, 1.0]),
    "on_sensor",
    tare_seconds=0.95,
    force_noise=2e-3,
    torque_noise=4e-5,
    position_noise=1e-5,
)
RATE, SPEED = 100.0, 0.01


class Sweep(NamedTuple):
    """What was scanned, and what the sensor made of it."""

    scan: vb.Scan
    reactions: vb.Reactions
    point: np.ndarray
    """True contact points of the recording's rows (n, 3)."""
    span: tuple[float, float]
    """Start and end of the contact [s]."""
    raw: RawRecording


def sweep(offset: float, seed: int, *, drift: float = 0.0, rate: float = RATE) -> Sweep:
    """One second at rest, then 80 mm along −x, `offset` [m] beside the ball's middle; the zero
    drifts by so many deviations in a second.
    """
    rng, rest = np.random.default_rng(seed), round(rate)
    start = np.array([0.04, offset, 0.0])
    moving = start - np.arange(round(0.08 / SPEED * rate))[:, None] * np.array([SPEED / rate, 0, 0])
    scan = vb.scan(WIRE, BALL, vb.Trail(moving))
    position = np.concatenate([np.tile(start, (rest, 1)), moving])
    time = np.arange(len(position)) / rate
    still = np.zeros((rest, 3))
    force, moment = (
        np.concatenate([still, part]) for part in (scan.reactions.force, scan.reactions.moment)
    )
    wander = np.cumsum(rng.normal(0, drift / np.sqrt(rate), (2, len(time), 3)), axis=1)
    wandering = vb.Reactions(
        vb.Trail(position), force + 2e-3 * wander[0], moment + 4e-5 * wander[1], time=time
    )
    raw = SENSOR.measure(wandering, rng, force_tare=(0.4, -0.1, 1.9))
    events = [
        event.parameter * (len(moving) - 1) + rest
        for event in scan.events
        if event.kind in (vb.EventKind.FIRST_CONTACT, vb.EventKind.DETACH)
    ]
    point = np.concatenate([np.full((rest, 3), np.nan), scan.point])
    return Sweep(scan, SENSOR.reactions(raw), point, (events[0] / rate, events[-1] / rate), raw)


def at_rest(count: int, seed: int, *, drift: float = 0.0) -> vb.Reactions:
    """A recording without any contact, its tare from the first second."""
    rng = np.random.default_rng(seed)
    time = np.arange(count) / RATE
    wander = np.cumsum(rng.normal(0, drift / np.sqrt(RATE), (2, count, 3)), axis=1)
    nothing = vb.Reactions(
        vb.Trail(np.zeros((count, 3))), 2e-3 * wander[0], 4e-5 * wander[1], time=time
    )
    return SENSOR.reactions(SENSOR.measure(nothing, rng, force_tare=(0.4, -0.1, 1.9)))
