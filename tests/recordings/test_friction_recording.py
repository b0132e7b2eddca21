"""A recording with Coulomb friction 0.25, made by an independent dynamics engine: against a scan of
the same trail, and its friction and normals found.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import vibrissa as vb

NAME, FRICTION = "friction_0.25/trail_y+0.10", 0.25
CENTER, RADIUS = np.array([0.0, 0.0, 0.0575]), 0.03


class Recorded(NamedTuple):
    """What was measured, what the engine knows, and what is found."""

    setup: vb.Setup
    reactions: vb.Reactions
    found: vb.Reconstruction
    point: np.ndarray
    force: np.ndarray
    touching: np.ndarray


@pytest.fixture(scope="module")
def recorded(sphere_60mm: Path) -> Recorded:
    setup = vb.load_setup(sphere_60mm / "setup.toml")
    reactions = vb.read_recording(sphere_60mm / f"{NAME}.csv", setup)
    truth = np.genfromtxt(sphere_60mm / f"{NAME}.truth.csv", delimiter=",", names=True)
    point, force = (
        np.stack([truth[name] for name in names], axis=1)
        for names in (("x", "y", "z"), ("fx", "fy", "fz"))
    )
    return Recorded(
        setup,
        reactions,
        vb.reconstruct(setup.rod, reactions, friction=FRICTION),
        point,
        force,
        truth["in_contact"] == 1,
    )


def off_the_normal(recorded: Recorded, direction: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Degrees between directions and the ball's normal at the true contact (k,)."""
    outward = recorded.point[rows] - CENTER
    cosine = np.sum(outward * direction[rows], axis=1) / np.linalg.norm(outward, axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_the_scan_with_friction_is_what_was_recorded(recorded: Recorded) -> None:
    """Before mid-trail, where the wire jumps to the ball's other side: the engine's wire later and
    with a swing, statics at once.
    """
    position, time = recorded.reactions.trail.position, recorded.reactions.time
    assert time is not None
    moving = np.abs(position[:, 0] - np.median(position[:200, 0])) > 1e-4
    first = int(np.argmax(moving))
    # The robot goes straight and evenly; what its pose adds to that is noise.
    line = np.stack(
        [
            np.polyval(np.polyfit(time[first:], position[first:, k], 1), time[first:])
            for k in range(3)
        ],
        axis=1,
    )
    assert np.std(position[first:] - line) < 1e-5
    scan = vb.scan(
        recorded.setup.rod, vb.surfaces.Sphere(CENTER, RADIUS), vb.Trail(line), friction=FRICTION
    )
    both = scan.in_contact & recorded.touching[first:]
    snap = next(event.clamp[0] for event in scan.events if event.kind == vb.EventKind.SNAP)
    assert -0.2 < snap / recorded.setup.rod.length < 0.2
    before = both & (line[:, 0] > max(snap, 0.0))
    assert np.count_nonzero(before) > 600
    largest = np.linalg.norm(recorded.force, axis=1).max()
    force = np.linalg.norm(-scan.reactions.force - recorded.force[first:], axis=1) / largest
    assert np.median(force[both]) < 0.015
    assert np.median(force[before]) < 0.005
    point = np.linalg.norm(scan.point - recorded.point[first:], axis=1)
    assert np.median(point[before]) < 0.01 * recorded.setup.rod.length
    # The frictionless law misses by much more: the agreement is friction's.
    smooth = vb.scan(recorded.setup.rod, vb.surfaces.Sphere(CENTER, RADIUS), vb.Trail(line))
    without = np.linalg.norm(-smooth.reactions.force - recorded.force[first:], axis=1) / largest
    assert np.nanmedian(without[before]) > 5 * np.median(force[before])


def test_the_force_is_off_the_normal_by_the_angle_of_friction(recorded: Recorded) -> None:
    assert recorded.setup.sensor.force_noise is not None
    strong = np.linalg.norm(recorded.force, axis=1) > 30 * recorded.setup.sensor.force_noise
    rows = recorded.touching & recorded.found.in_contact & strong
    assert np.median(off_the_normal(recorded, recorded.found.normal, rows)) == pytest.approx(
        14.04, abs=0.1
    )
    assert np.degrees(recorded.found.normal_half_angle) == pytest.approx(14.036, abs=1e-3)


def test_friction_and_normals_are_found_from_the_contacts_alone(recorded: Recorded) -> None:
    estimate = vb.estimate_friction(recorded.found)
    assert estimate.friction == pytest.approx(FRICTION, abs=0.03)
    assert abs(estimate.friction - FRICTION) < 3 * estimate.standard_error
    rows = recorded.touching & np.isfinite(estimate.normal[:, 0])
    assert np.count_nonzero(rows) > 500
    mended, raw = (
        np.median(off_the_normal(recorded, direction, rows))
        for direction in (estimate.normal, recorded.found.normal)
    )
    assert mended < 4
    assert raw == pytest.approx(14.04, abs=0.5)
    np.testing.assert_allclose(np.linalg.norm(estimate.normal[rows], axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(
        np.sum(estimate.normal[rows] * estimate.sliding[rows], axis=1), 0, atol=1e-12
    )
