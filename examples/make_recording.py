"""A recording as a lab would hand it over, made from a scan: with tare, noise, quantisation, and a
sensor that is rotated and offset.

A steel wire of 50 mm is swept under a sphere of 60 mm at 10 mm/s and logged at 100 Hz, after one
second at rest.
"""

from pathlib import Path

import numpy as np

import vibrissa as vb
from vibrissa.io import write_recording

FOLDER = Path(__file__).parent / "recordings" / "sphere_60mm"
RATE, SPEED = 100.0, 0.01
REST = 1.0


def main(path: Path = FOLDER / "trail.csv") -> vb.Scan:
    """Write the recording and return the scan it comes from."""
    setup = vb.load_setup(FOLDER / "setup.toml")
    assert setup.surface is not None
    start, stop = np.array([0.04, 0.006, 0.0]), np.array([-0.04, 0.006, 0.0])
    moving = int(RATE * np.linalg.norm(stop - start) / SPEED) + 1
    position = np.vstack(
        [np.repeat(start[None], int(REST * RATE), axis=0), np.linspace(start, stop, moving)]
    )
    scan = vb.scan(setup.rod, setup.surface, vb.Trail(position))
    time = (np.arange(len(position)) + 0.5) / RATE
    reactions = vb.Reactions(scan.trail, scan.reactions.force, scan.reactions.moment, time=time)
    raw = setup.sensor.measure(
        reactions,
        np.random.default_rng(1),
        force_tare=(0.31, -0.12, 1.93),
        torque_tare=(2.1e-3, -4.0e-3, 7e-4),
    )
    write_recording(path, raw)
    return scan


if __name__ == "__main__":
    main()
