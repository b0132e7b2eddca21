"""Scans of many objects against shooting, which shares nothing with the closed form, and the returned states put back into the rod's equation."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shooting import Equilibrium, Level, clamp_tangent, follow, height_field, paraboloid, quadric, rod_end

import vibrissa as vb

TOLERANCE = 1e-8
TURN, SHIFT = Rotation.from_euler("xyz", [25, -15, 40], degrees=True), np.array([0.1, -0.2, 0.05])
WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)


class Case(NamedTuple):
    """An object twice, for the package and for shooting, in units of the rod, and a trail."""

    surface: vb.surfaces.Surface
    level: Level
    trail: vb.Trail
    rod: vb.Rod = vb.Rod.unit()


def line(start: list[float], stop: list[float], axis: list[float], count: int = 49) -> vb.Trail:
    return vb.Trail.line(start=np.array(start), stop=np.array(stop), count=count, axis=np.array(axis))


def sphere() -> Case:
    center = np.array([0.0, 0.0, 1.15])
    surface = vb.surfaces.Sphere(center=center, radius=0.6)
    return Case(surface, quadric(center, 0.6 * np.ones(3)), line([1.1, 0.2, 0.1], [-0.5, 0.25, -0.1], [-0.25, 0.1, 1.0]))


def wire_on_a_ball() -> Case:
    center = np.array([0.0, 0.0, 0.06])
    surface = vb.surfaces.Sphere(center=center, radius=0.03)
    return Case(surface, quadric(center, 0.03 * np.ones(3)), line([0.06, 0.01, 0.0], [-0.04, 0.01, 0.0], [0.0, 0.0, 1.0]), WIRE)


def placed_paraboloid() -> Case:
    surface = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4).placed(rotation=TURN, translation=SHIFT)
    start, stop = TURN.apply([[1.2, 0.2, 0.0], [-0.9, 0.15, 0.0]]) + SHIFT
    trail = line(start.tolist(), stop.tolist(), TURN.apply([-0.1, 0.15, 1.0]).tolist())
    return Case(surface, paraboloid(0.5, 1.0, 0.4).placed(TURN, SHIFT), trail)


def ellipsoid_turning_clamp() -> Case:
    center, semi_axes = np.array([0.1, 0.0, 1.2]), np.array([0.8, 0.5, 0.6])
    turning = Rotation.from_rotvec(np.linspace(-0.35, 0.35, 49)[:, None] * [0.1, 1.0, 0.2]) * Rotation.from_euler("z", 0.3)
    trail = vb.Trail(np.linspace([1.1, 0.25, 0.0], [0.0, 0.1, 0.1], 49), turning.as_quat())
    return Case(vb.surfaces.Ellipsoid(center=center, semi_axes=semi_axes), quadric(center, semi_axes), trail)


def elliptic_cylinder() -> Case:
    center = np.array([0.0, 0.0, 1.1])
    surface = vb.surfaces.EllipticCylinder(center=center, semi_axes=np.array([0.7, 0.5]))
    level = quadric(center, np.array([0.7, np.inf, 0.5]))
    return Case(surface, level, line([1.3, 0.3, 0.0], [0.1, 0.2, 0.0], [0.1, 0.4, 1.0]))


def wavy_height_field() -> Case:
    surface = vb.surfaces.HeightField(lambda x, y: 0.5 + 0.4 * x * x + 0.3 * x * y + 0.7 * y * y + 0.05 * jnp.sin(4 * x))
    level = height_field(
        lambda x, y: 0.5 + 0.4 * x * x + 0.3 * x * y + 0.7 * y * y + 0.05 * np.sin(4 * x),
        lambda x, y: (0.8 * x + 0.3 * y + 0.2 * np.cos(4 * x), 0.3 * x + 1.4 * y),
    )
    return Case(surface, level, line([1.3, 0.35, 0.0], [-0.7, 0.3, 0.05], [0.05, -0.1, 1.0]))


CASES = {case.__name__: case for case in (sphere, wire_on_a_ball, placed_paraboloid, ellipsoid_turning_clamp, elliptic_cylinder, wavy_height_field)}


class Pair(NamedTuple):
    """One case, scanned and shot."""

    case: Case
    scan: vb.Scan
    shot: list[Equilibrium | None]


@pytest.fixture(scope="module", params=CASES)
def pair(request: pytest.FixtureRequest) -> Pair:
    case = CASES[request.param]()
    length = case.rod.length
    tangents = np.array([clamp_tangent(q) for q in case.trail.orientation])
    shot = follow(case.level.scaled(length), case.trail.position / length, tangents)
    return Pair(case, vb.scan(case.rod, case.surface, case.trail), shot)


def test_both_kinds_of_contact_occur(pair: Pair) -> None:
    counts = np.bincount(pair.scan.kind, minlength=3)
    print(counts, np.bincount(pair.scan.status), [e.kind.name for e in pair.scan.events])
    assert np.all(counts >= 3)
