"""A made-up bench for calibrations: a wire swept under a ball, measured by a sensor that sits
askew.
"""

from dataclasses import replace
from functools import cache

import calibration_sweeps
import numpy as np
from scipy.spatial.transform import Rotation

import vibrissa as vb

WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
BALL = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
CLAMP, TURN = np.array([0.003, -0.002, 0.02]), Rotation.from_rotvec([0.1, 0.2, -0.4])
REST, COUNT, RATE = 80, 260, 50.0
FORCE_TARE, TORQUE_TARE = (0.3, -0.1, 1.9), (2e-3, -4e-3, 7e-4)
NAMES = (
    "youngs_modulus",
    "length",
    "clamp_position_x",
    "clamp_position_y",
    "clamp_position_z",
    "clamp_orientation_x",
    "clamp_orientation_y",
)


def sensor(noise: float = 1.0, **options: object) -> vb.Sensor:
    """The sensor, with its noise or a share of it."""
    figures = {
        "force_noise": 2e-3 * noise,
        "torque_noise": 4e-5 * noise,
        "position_noise": 1e-5 * noise,
        "tare_seconds": 1.5,
    }
    return vb.Sensor(
        CLAMP, TURN.as_quat(), "on_sensor", wrench_point=(0.001, 0.0, 0.002), **(figures | options)
    )


def swept(y: float) -> vb.Reactions:
    """Reactions of a sweep under the ball along x, at first at rest and free of contact."""
    return independent(f"ball {y:+.3f}")


@cache
def independent(name: str) -> vb.Reactions:
    """The same by shooting, without the package."""
    resting = ((REST, 0), (0, 0))
    position, force, moment = calibration_sweeps.loaded(name)
    return vb.Reactions(
        vb.Trail(np.pad(position, resting, mode="edge")),
        np.pad(force, resting),
        np.pad(moment, resting),
        time=np.arange(REST + COUNT) / RATE,
    )


def recordings(one: vb.Sensor, seed: int = 0, heights: tuple[float, ...] = (0.005, -0.01)) -> list:
    """What the sensor logs of sweeps at these heights."""
    rng = np.random.default_rng(seed)
    return [
        one.measure(swept(y), rng, force_tare=FORCE_TARE, torque_tare=TORQUE_TARE) for y in heights
    ]


def setup(one: vb.Sensor) -> vb.Setup:
    """The truth."""
    return vb.Setup(WIRE, one, BALL)


def wrong(truth: vb.Setup, signs: tuple[int, int] = (1, -1)) -> vb.Setup:
    """Off by 20 % in EI, 3 % in L, 2 mm and 3° of the clamp."""
    move = 2e-3 * np.array([0.6, -0.6, np.sqrt(0.28)])
    turn = TURN * Rotation.from_rotvec(np.radians(3) * np.array([0.6, 0.8, 0.0]))
    rod = replace(
        WIRE,
        bending_stiffness=WIRE.bending_stiffness * (1 + 0.2 * signs[0]),
        length=WIRE.length * (1 + 0.03 * signs[1]),
    )
    return replace(
        truth,
        rod=rod,
        sensor=replace(truth.sensor, clamp_position=CLAMP + move, clamp_orientation=turn.as_quat()),
    )


def true_values(start: vb.Setup) -> dict[str, float]:
    """Of all that two sweeps determine, the clamp's turn seen from where the calibration starts."""
    back = Rotation.from_quat(start.sensor.clamp_orientation).inv()
    x, y, z = back.apply(TURN.apply([0, 0, 1]))
    turn = np.arctan2(np.hypot(x, y), z) * np.array([-y, x]) / np.hypot(x, y)
    return dict(zip(NAMES, (206e9, 0.05, *CLAMP, *turn), strict=True))
