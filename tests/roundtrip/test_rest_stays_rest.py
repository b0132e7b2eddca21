"""Contacts of many noisy recordings of one sweep end where the rod lets go."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.sensor import preset

WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
EGG = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.030, 0.020, 0.022)).placed(
    rotation=Rotation.from_euler("z", 40, degrees=True).as_quat(), translation=(0, 0, 0.052)
)
SENSOR = replace(
    preset("ati_nano17_si_12_0_12", clamp_position=(0, 0, 0.025)),
    position_noise=2e-5,
    tare_seconds=None,
)
RUNS, ROWS = 12, 401
CLOSE = 12
"""Rows, 2.7 mm of the clamp's way, by which a start or an end in noise may be off."""


def test_samples_at_rest_are_no_contacts() -> None:
    """Half of each recording is rest. Whichever way the first fit goes, no sample of it far from
    the contact passes for one.
    """
    ends = (0.045, -0.005, 0), (-0.045, -0.005, 0)
    scan = vb.scan(WIRE, EGG, vb.Trail.line(start=ends[0], stop=ends[1], count=ROWS))
    given = vb.Reactions(
        scan.trail, scan.reactions.force, scan.reactions.moment, time=np.arange(ROWS) / 100
    )
    near = np.convolve(scan.in_contact, np.ones(2 * CLOSE + 1), "same") > 0
    rng, wrong = np.random.default_rng(7), []
    for _ in range(RUNS):
        measured = SENSOR.measure(given, rng, force_tare=(0.3, -0.1, 0.8))
        found = vb.reconstruct(WIRE, SENSOR.reactions(measured), friction=0, check=False)
        smooth = vb.smooth(found)
        passed = smooth.in_contact & (smooth.status == vb.Status.OK)
        wrong.append(np.count_nonzero(passed & ~near))
        assert np.count_nonzero(passed & scan.in_contact) > 0.5 * np.count_nonzero(scan.in_contact)
    assert wrong == [0] * RUNS
