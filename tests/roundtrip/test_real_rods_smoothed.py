"""Simulated sweeps with rods that are tapered, curved, heavy or softly held, smoothed: errors and
their ellipsoids; and the same recordings taken for those of a plain rod.
"""

import re
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

import vibrissa as vb
from vibrissa.live.smoothing import SmoothingStage

LENGTH, RATE, REST, COUNT = 0.05, 50.0, 50, 325
BOWL = vb.surfaces.EllipticParaboloid(a=0.5 / LENGTH, b=1.0 / LENGTH, h=0.4 * LENGTH)
BALL = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
TAPERED = vb.Rod.tapered(
    length=LENGTH, base_radius=0.25e-3, tip_radius=0.1e-3, youngs_modulus=206e9
)
HEAVY = vb.Rod.cylinder(length=LENGTH, radius=0.1e-3, youngs_modulus=6e9, density=7000.0)
WIRE = vb.Rod.cylinder(length=LENGTH, radius=0.25e-3, youngs_modulus=206e9)
SWEEPS = {
    "tapered": (TAPERED, BOWL),
    "curved": (TAPERED.curved(vb.RestShape.arc(0.1, roll=0.7)), BALL),
    "heavy": (HEAVY.loaded(vb.Loads(gravity=(0, 0, -9.81))), BALL),
    "soft": (WIRE.on(vb.Support.pivot(stiffness=(0.1, 0.15, 0.5))), BOWL),
}
PLAIN = {
    "tapered": (15, "in tangential contact k² is 0.2.* likely a taper, the radius 60 % lower"),
    "curved": (20, "the moment along the rod is not 0, .* or a rod that is not straight"),
    "heavy": (5, "s₁ in tip contact is 2. mm too short"),
    "soft": (8, "in tangential contact k² is 0.4.* no single cause explains it"),
}
"""At least this median error of straight, uniform, weightless and rigidly held rods [% of the
length]; measured 18, 24, 6 to 8 and 9 to 11. And what is said of the sweep.
"""
NAMES = (
    *("tapered", "curved"),
    *(pytest.param(n, marks=pytest.mark.slow) for n in ("heavy", "soft")),
)
INSIDE = chi2.isf(0.05, 3)


@cache
def swept(name: str) -> tuple[vb.Scan, vb.Reconstruction]:
    """One second at rest, then along −x with an inclined clamp; the sensor has not been tared, as
    that would take the rod's weight off.
    """
    rod, surface = SWEEPS[name]
    way = np.maximum(np.arange(REST + COUNT) - REST, 0) / RATE
    position = np.array([0.065, 0.012, 0.0]) - 0.02 * way[:, None] * [1, 0, 0]
    turned = np.tile([0.05, -0.05, 0.02, 1.0], (len(way), 1))
    scan = vb.scan(rod, surface, vb.Trail(position, turned))
    true = vb.Reactions(
        scan.trail,
        scan.reactions.force,
        scan.reactions.moment,
        time=np.arange(len(way)) / RATE,
    )
    sensor = vb.Sensor(
        np.array([0.0, 0.0, 0.025]),
        np.array([0.0, 0.0, 0.0, 1.0]),
        "on_sensor",
        tare_seconds=0.0,
        force_noise=2e-3 * rod.force_scale,
        torque_noise=8e-4 * rod.moment_scale,
        position_noise=1e-5,
    )
    raw = sensor.measure(true, np.random.default_rng(1))
    return scan, vb.reconstruct(rod, sensor.reactions(raw))


def inner(scan: vb.Scan) -> np.ndarray:
    """Rows of the contact without its first and last twentieth."""
    rows = np.flatnonzero(scan.in_contact)
    return rows[len(rows) // 20 : -(len(rows) // 20)]


def distances(found: vb.Reconstruction, scan: vb.Scan, rows: np.ndarray) -> np.ndarray:
    """Squared errors of the points in units of the stated covariances."""
    assert found.covariance is not None
    error = found.point[rows] - scan.point[rows]
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance[rows]), error)


@pytest.mark.parametrize("name", NAMES)
def test_points_are_better_than_raw_ones_and_within_their_ellipsoids(name: str) -> None:
    scan, found = swept(name)
    smooth, rows = vb.smooth(found), inner(scan)
    assert len(rows) > 60 and set(scan.kind[rows]) == {
        vb.ContactKind.TIP,
        vb.ContactKind.TANGENTIAL,
    }
    raw, better = (
        np.linalg.norm(part.point[rows] - scan.point[rows], axis=1) for part in (found, smooth)
    )
    assert np.median(better) < np.nanmedian(raw) / 1.5
    assert np.mean(smooth.status[rows] == vb.Status.OK) > 0.95
    assert smooth.in_contact[:REST].sum() == 0
    # Neighbouring errors are nearly the same: as for the straight rod.
    distance = distances(smooth, scan, rows)
    assert np.mean(distance < INSIDE) > 0.8
    assert np.mean(distance) > 0.5


@pytest.mark.parametrize("name", NAMES)
def test_covariances_are_what_points_answer_to_small_errors(name: str) -> None:
    """Before the tip: points of wrenches that are a deviation off to either side, one component at
    a time.
    """
    scan, found = swept(name)
    rows = np.flatnonzero(scan.kind == vb.ContactKind.TANGENTIAL)[::12]
    deviation = 1e-6 * np.repeat([found.rod.force_scale, found.rod.moment_scale], 3)
    steps = np.concatenate([np.diag(deviation), -np.diag(deviation), np.zeros((1, 6))])
    true = np.hstack([scan.reactions.force[rows], scan.reactions.moment[rows]])
    # Reactions are given about the clamp in world axes, their covariance too.
    wrench = (true[:, None] + steps).reshape(-1, 6)
    every = np.repeat(rows, len(steps))
    trail = vb.Trail(scan.trail.position[every], scan.trail.orientation[every])
    given = vb.Reactions(trail, wrench[:, :3], wrench[:, 3:], covariance=np.diag(deviation**2))
    seen = vb.reconstruct(found.rod, given, check=False)
    assert np.all(seen.kind == vb.ContactKind.TANGENTIAL)
    point = seen.point.reshape(len(rows), len(steps), 3)
    change = (point[:, :6] - point[:, 6:12]) / 2
    assert seen.covariance_noise is not None
    stated = seen.covariance_noise.reshape(len(rows), len(steps), 3, 3)[:, -1]
    measured = np.einsum("nki,nkj->nij", change, change)
    assert len(rows) >= 5
    np.testing.assert_allclose(measured, stated, rtol=1e-5, atol=1e-5 * np.abs(stated).max())


@pytest.mark.parametrize("name", NAMES)
def test_the_weakest_contacts_have_ellipsoids(name: str) -> None:
    """With ten times the noise, which puts some of them behind the clamp."""
    scan, found = swept(name)
    scale = np.repeat([found.rod.force_scale, found.rod.moment_scale], 3)
    noise = np.diag((np.repeat([2e-2, 8e-3], 3) * scale) ** 2)
    seen = vb.reconstruct(found.rod, replace(scan.reactions, covariance=noise), check=False)
    rows = np.flatnonzero(seen.in_contact)
    assert seen.covariance is not None
    semi_axes = np.sqrt(np.linalg.eigvalsh(seen.covariance[rows])) / LENGTH
    assert np.all((semi_axes > 0) & (semi_axes < 1))
    assert np.all(np.isfinite(seen.normal_covariance[rows]))
    assert semi_axes[0, 2] > 0.1


@pytest.mark.parametrize("name", NAMES)
def test_a_plain_rod_in_its_place_is_wrong_and_said_to_be(name: str) -> None:
    """The recordings whose contacts are right above: no row passes for sound, neither sample by
    sample nor smoothed, and the sweep as a whole is said to contradict the rod.
    """
    scan, right = swept(name)
    plain = replace(right.rod, section=None, rest=None, loads=None, support=None)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = vb.reconstruct(plain, right.reactions)
        smooth = vb.smooth(found)
    least, said = PLAIN[name]
    rows = inner(scan)
    for part in (found, smooth):
        error = np.linalg.norm(part.point[rows] - scan.point[rows], axis=1)
        assert np.nanmedian(error) > least / 100 * LENGTH
        assert np.mean(distances(part, scan, rows) < INSIDE) < 0.05
        assert not np.any(part.status[rows] == vb.Status.OK)
    assert any(re.search(said, str(one.message)) for one in caught), caught
    assert any(re.search(said, line) for line in found.warnings)
    # The weight, which no tare took off, passes for contact all the time: there too it is said.
    assert np.all(found.in_contact[:REST]) == (name == "heavy")
    assert not np.any(found.in_contact[:REST] & (found.status[:REST] == vb.Status.OK))


def test_a_live_stream_of_a_curved_tapered_rod_is_smoothed() -> None:
    scan, found = swept("curved")
    live, rows = SmoothingStage(found.rod).push(found), inner(scan)
    raw, better = (
        np.linalg.norm(part.point[rows] - scan.point[rows], axis=1) for part in (found, live)
    )
    known = np.isfinite(better)
    assert known.mean() > 0.9
    assert np.median(better[known]) < np.nanmedian(raw)
    assert np.mean(distances(live, scan, rows[known]) < INSIDE) > 0.8
    assert live.in_contact[:REST].sum() <= 1
