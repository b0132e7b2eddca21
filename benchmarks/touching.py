"""Objects touched from six sides by a wire on a simulated sensor, through the whole chain."""

import numpy as np
from scipy.spatial.transform import Rotation

import vibrissa as vb

WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
SENSOR = vb.Sensor(
    np.array([0.0, 0.0, 0.025]),
    np.array([0.0, 0.0, 0.0, 1.0]),
    "on_sensor",
    tare_seconds=0.95,
    force_noise=2e-3,
    torque_noise=4e-5,
    position_noise=1e-5,
)
REACH, AWAY, RATE = 0.04, 0.05, 50.0
"""Half a sweep's length, the clamp's distance from the object's middle [m]; samples a second."""


def touched(
    surface: vb.surfaces.Surface, offsets: np.ndarray, *, crosswise: bool = False
) -> list[vb.Contacts]:
    """Contacts of parallel sweeps from six sides, in two directions if asked, at such distances
    from each side's middle [m]: one object for each sweep.
    """
    arm = vb.SimulatedArm(WIRE, surface, SENSOR, rate=RATE, rng=np.random.default_rng(0))
    sides = [Rotation.from_euler("x", 90 * i, degrees=True) for i in range(4)]
    sides += [Rotation.from_euler("y", angle, degrees=True) for angle in (90, -90)]
    quarter = Rotation.from_euler("z", 90, degrees=True)
    parts = []
    for i, side in enumerate(sides):
        for turned in (side, side * quarter)[: 1 + crosswise]:
            for offset in offsets + 1e-3 * i - 2e-3:
                ends = turned.apply([[REACH, offset, -AWAY], [-REACH, offset, -AWAY]])
                trail = vb.Trail(ends, np.tile(turned.as_quat(), (2, 1)))
                parts.append(arm(trail).contacts)
    return parts
