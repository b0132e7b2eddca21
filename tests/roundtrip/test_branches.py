"""A hook whose tip pushes towards its stem: two contacts explain the reactions. Smoothing follows
the one from which the sweep goes on, and says so where nothing tells.
"""

from functools import cache

import numpy as np
import pytest

import vibrissa as vb
from vibrissa.inverse.smoothing.branches import branch_of

LENGTH, RATE, REST, COUNT = 0.05, 50.0, 60, 200
ARC = vb.RestShape.arc(radius=0.4 * LENGTH)
HOOK = vb.Rod.cylinder(length=LENGTH, radius=0.25e-3, youngs_modulus=206e9).curved(ARC)
TIP = 0.4 * LENGTH * np.array([1 - np.cos(2.5), 0, np.sin(2.5)])


@cache
def swept(rise: float, way: float) -> tuple[vb.Scan, vb.Reactions]:
    """The hook led towards a ball ahead of its tip, after a second of rest; the readings."""
    ball = vb.surfaces.Sphere(center=TIP + LENGTH * np.array([0.305, 0, rise]), radius=0.3 * LENGTH)
    start, stop = LENGTH * np.array([[0, 0, -0.03], [way, 0, 0.03]])
    moving = np.linspace(start, stop, COUNT)
    scan = vb.scan(HOOK, ball, vb.Trail(np.vstack([np.tile(start, (REST, 1)), moving])))
    true = vb.Reactions(
        scan.trail,
        scan.reactions.force,
        scan.reactions.moment,
        time=np.arange(REST + COUNT) / RATE,
    )
    sensor = vb.Sensor(
        np.zeros(3),
        np.array([0.0, 0, 0, 1]),
        "on_sensor",
        tare_seconds=0.0,
        force_noise=5e-4 * HOOK.force_scale,
        torque_noise=2e-4 * HOOK.moment_scale,
        position_noise=1e-5,
    )
    return scan, sensor.reactions(sensor.measure(true, np.random.default_rng(1)))


@pytest.mark.parametrize(
    "sweep", [pytest.param((0.05, 0.05), marks=pytest.mark.slow), (0.08, 0.02)]
)
def test_smoothing_follows_the_contact_that_continues(sweep: tuple[float, float]) -> None:
    """In the first sweep the second half has one contact only; in the other only the tip tells."""
    scan, readings = swept(*sweep)
    found = vb.reconstruct(HOOK, readings)
    open_rows = found.status == vb.Status.NOT_UNIQUE
    assert open_rows.sum() > 40 and found.warnings == []
    smooth = vb.smooth(found)
    (told,) = smooth.smoothing
    assert np.all(told.branch_probability[~open_rows] == 1)
    assert np.all(branch_of(found).arc_length[open_rows] > 0.7)
    assert np.mean(told.branch_probability[open_rows] > 0.95) > 0.9
    doubtful = told.branch_probability < 0.95
    touching = scan.in_contact & smooth.in_contact
    sure = touching & (smooth.status == vb.Status.OK)
    assert not np.any(sure & doubtful) and np.mean(sure[touching]) > 0.6
    off = np.linalg.norm(smooth.point - scan.point, axis=1)
    assert off[sure].max() < 0.02 * LENGTH


def test_a_touch_of_which_nothing_tells_stays_open() -> None:
    """On a longer hook the same reactions come from two places before its tip: either continues
    itself.
    """
    scan, readings = swept(0.08, 0.02)
    rows = scan.in_contact
    longer = vb.Rod.cylinder(length=1.05 * LENGTH, radius=0.25e-3, youngs_modulus=206e9)
    found = vb.reconstruct(longer.curved(ARC), readings, check=False)
    assert np.mean(found.status[rows] == vb.Status.NOT_UNIQUE) > 0.9
    assert np.all(branch_of(found).probability[found.status == vb.Status.NOT_UNIQUE] < 0.9)


def test_a_frictionless_hook_is_not_averaged_with_contacts_far_from_it() -> None:
    """The tip pushes at an angle that no frictionless contact on its flank has: what such a rival
    would need is far from the readings, and must not move the contact at the tip.
    """
    scan, readings = swept(0.05, 0.05)
    smooth = vb.smooth(vb.reconstruct(HOOK, readings, friction=0.0))
    rows = scan.in_contact & smooth.in_contact
    assert rows.sum() > 0.95 * scan.in_contact.sum() and np.all(smooth.status[rows] == vb.Status.OK)
    off = np.linalg.norm(smooth.point - scan.point, axis=1)[rows]
    assert smooth.covariance is not None
    deviation = np.sqrt(np.trace(smooth.covariance[rows], axis1=1, axis2=2))
    assert off.max() < 0.005 * LENGTH and np.all(off < 4 * deviation)
