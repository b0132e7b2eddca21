"""Reactions with noise of known covariance: the errors of the contacts are those that are stated.

The noise is that of a small force/torque sensor that carries a 50 mm steel wire at half its length,
in model units.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import binom, chi2

import vibrissa as vb

UNIT = vb.Rod.unit()
WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
FORCE_NOISE, TORQUE_NOISE, ARM = (
    2e-3 / WIRE.force_scale,
    4e-5 / WIRE.moment_scale,
    np.array([0.0, 0.0, 0.5]),
)
SAMPLES = 4000
WITHIN = chi2.isf(0.05, 3)


def wrench_noise(rng: np.random.Generator, count: int) -> np.ndarray:
    """Errors of (f0, m0) (count, 6): a sensor's own, its torque carried to the clamp."""
    force = rng.normal(scale=FORCE_NOISE, size=(count, 3))
    return np.concatenate(
        [force, rng.normal(scale=TORQUE_NOISE, size=(count, 3)) - np.cross(ARM, force)], axis=1
    )


def noise_covariance() -> np.ndarray:
    """Of (f0, m0) (6, 6)."""
    lever = np.array([np.cross(ARM, axis) for axis in np.eye(3)]).T
    spread = np.zeros((6, 6))
    spread[:3, :3] = np.eye(3)
    spread[3:, :3], spread[:3, 3:] = -lever, -lever.T
    spread[3:, 3:] = (TORQUE_NOISE / FORCE_NOISE) ** 2 * np.eye(3) + lever @ lever.T
    return FORCE_NOISE**2 * spread


COVARIANCE = noise_covariance()


class Sampled(NamedTuple):
    """One position of a scan, measured many times."""

    scan: vb.Scan
    row: int
    found: vb.Reconstruction

    @property
    def error(self) -> np.ndarray:
        """Of the contact point, of samples in contact (k, 3)."""
        return self.found.point[self.found.in_contact] - self.scan.point[self.row]

    def distance(self) -> np.ndarray:
        """Squared errors in units of the stated covariances (k,)."""
        assert self.found.covariance is not None
        inverse = np.linalg.inv(self.found.covariance[self.found.in_contact])
        return np.einsum("ni,nij,nj->n", self.error, inverse, self.error)


def reactions(
    position: np.ndarray, force: np.ndarray, moment: np.ndarray, noise: np.ndarray
) -> vb.Reactions:
    trail = vb.Trail(np.tile(position, (len(noise), 1)))
    return vb.Reactions(trail, force + noise[:, :3], moment + noise[:, 3:], covariance=COVARIANCE)


def sampled(scan: vb.Scan, row: int, seed: int) -> Sampled:
    noise = wrench_noise(np.random.default_rng(seed), SAMPLES)
    given = reactions(
        scan.trail.position[row], scan.reactions.force[row], scan.reactions.moment[row], noise
    )
    return Sampled(scan, row, vb.reconstruct(UNIT, given))


# y0, x0: in the middle of contact, far from first contact and from the changes of phase.
TANGENTIAL = [(0.1, 0.0), (0.1, 0.2), (0.2, -0.1)]
TIP = [(0.5, 0.0), (0.4, 0.2), (0.1, 0.9)]


@pytest.fixture(scope="module")
def measured() -> dict[tuple[float, float], Sampled]:
    surface, found = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4), {}
    for y0, x0 in TANGENTIAL + TIP:
        scan = vb.scan(UNIT, surface, vb.Trail.line(start=(1.2, y0, 0), stop=(x0, y0, 0), count=49))
        assert scan.kind[-1] == (
            vb.ContactKind.TIP if (y0, x0) in TIP else vb.ContactKind.TANGENTIAL
        )
        found[y0, x0] = sampled(scan, 48, seed=round(1000 * y0 + 100 * x0 + 500))
    return found


@pytest.mark.parametrize("where", TANGENTIAL)
def test_errors_have_the_stated_covariance(
    measured: dict[tuple[float, float], Sampled], where: tuple[float, float]
) -> None:
    """In units of the stated standard deviations the errors' covariance is the identity, and they
    have no bias.
    """
    sample = measured[where]
    assert np.all(sample.found.in_contact)
    assert sample.found.covariance is not None
    root = np.linalg.inv(np.linalg.cholesky(sample.found.covariance.mean(axis=0)))
    np.testing.assert_allclose(root @ np.cov(sample.error.T) @ root.T, np.eye(3), rtol=0, atol=0.12)
    assert np.linalg.norm(root @ sample.error.mean(axis=0)) < 0.12


@pytest.mark.parametrize("where", TANGENTIAL)
def test_arc_length_and_normal_have_the_stated_errors(
    measured: dict[tuple[float, float], Sampled], where: tuple[float, float]
) -> None:
    sample = measured[where]
    found, row = sample.found, sample.row
    assert found.arc_length_deviation is not None
    assert found.normal_covariance is not None
    spread = np.std(found.arc_length - sample.scan.arc_length[row])
    assert spread == pytest.approx(found.arc_length_deviation.mean(), rel=0.06)
    # The normal's errors lie in the plane square to it.
    n = sample.scan.normal[row]
    plane = np.linalg.svd(n[None])[2][1:]
    stated = plane @ found.normal_covariance.mean(axis=0) @ plane.T
    root = np.linalg.inv(np.linalg.cholesky(stated))
    seen = np.cov(plane @ (found.normal - n).T)
    np.testing.assert_allclose(root @ seen @ root.T, np.eye(2), rtol=0, atol=0.12)


@pytest.mark.parametrize("where", TANGENTIAL + TIP)
def test_the_95_percent_ellipsoids_hold_the_true_point(
    measured: dict[tuple[float, float], Sampled], where: tuple[float, float]
) -> None:
    assert 0.92 < np.mean(measured[where].distance() < WITHIN) < 0.98


@pytest.mark.parametrize("where", TIP)
def test_at_the_tip_knowing_the_length_helps(
    measured: dict[tuple[float, float], Sampled], where: tuple[float, float]
) -> None:
    """No point beyond the rod, and none of the errors larger than stated."""
    sample = measured[where]
    assert sample.found.covariance is not None
    assert np.all(sample.found.arc_length < 1 + 1e-6)
    root = np.linalg.inv(np.linalg.cholesky(sample.found.covariance.mean(axis=0)))
    variances = np.linalg.eigvalsh(root @ np.cov(sample.error.T) @ root.T)
    assert variances[-1] < 1.12
    assert variances[0] < 0.6
    assert np.mean(sample.found.kind == vb.ContactKind.TIP) > 0.95


@pytest.mark.parametrize("where", TANGENTIAL)
def test_tangential_contact_is_not_taken_for_tip_contact(
    measured: dict[tuple[float, float], Sampled], where: tuple[float, float]
) -> None:
    """These touch by more than six standard deviations before the tip."""
    found = measured[where].found
    assert found.arc_length_deviation is not None
    clear = (1 - measured[where].scan.arc_length[48]) / found.arc_length_deviation.mean()
    assert np.mean(found.kind == vb.ContactKind.TANGENTIAL) > (0.999 if clear > 6 else 0.9)


@pytest.mark.parametrize("false_alarm", [1e-3, 1e-2, 0.1])
def test_the_contact_test_errs_as_often_as_it_says(false_alarm: float) -> None:
    count = 30_000
    noise = wrench_noise(np.random.default_rng(42), count)
    zero = np.zeros(3)
    found = vb.reconstruct(UNIT, reactions(zero, zero, zero, noise), false_alarm=false_alarm)
    low, high = binom.interval(0.9999, count, false_alarm)
    assert low <= np.count_nonzero(found.in_contact) <= high
    assert np.all(np.isnan(found.point[~found.in_contact]))


@pytest.mark.parametrize("y0", [0.1, 0.3, 0.5])
def test_near_first_contact_no_point_is_farther_than_the_rod_reaches(y0: float) -> None:
    """A chord is no longer than its arc, whatever the noise: points within 5 % of a rod length, and
    honest about themselves.
    """
    surface = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
    first = np.sqrt(2 * (0.6 - y0**2))
    trail = vb.Trail.line(start=(first - 1e-4, y0, 0), stop=(first - 0.03, y0, 0), count=9)
    scan = vb.scan(UNIT, surface, trail)
    held, all_of_them = 0, 0
    for row in np.flatnonzero(scan.in_contact):
        sample = sampled(scan, int(row), seed=int(row))
        told = sample.found.in_contact & (sample.found.status == vb.Status.OK)
        reach = np.linalg.norm(sample.found.point[told] - trail.position[row], axis=1)
        assert reach.max(initial=0) < 1.05
        held += np.count_nonzero(sample.distance() < WITHIN)
        all_of_them += np.count_nonzero(sample.found.in_contact)
    assert 0.87 < held / all_of_them < 0.99


def test_three_times_the_noise_is_not_missed() -> None:
    """A force of five standard deviations at the tip is found nearly always at the usual false
    alarm rate.
    """
    force = 5 * FORCE_NOISE * np.array([0.6, 0.0, -0.8])
    noise = wrench_noise(np.random.default_rng(1), SAMPLES)
    moment = -np.cross([0.0, 0.0, 1.0], force)
    found = vb.reconstruct(UNIT, reactions(np.zeros(3), -force, moment, noise))
    assert np.mean(found.in_contact) > 0.99
