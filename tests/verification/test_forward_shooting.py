"""Scans of many objects against shooting in space, and the returned states put back into the rod's
own equation.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shooting import (
    Equilibrium,
    Level,
    clamp_tangent,
    follow,
    height_field,
    paraboloid,
    quadric,
    rod_along,
)

import vibrissa as vb

TOLERANCE = 1e-8
COUNT = 49
TURN, SHIFT = Rotation.from_euler("xyz", [25, -15, 40], degrees=True), np.array([0.1, -0.2, 0.05])


class Case(NamedTuple):
    """An object twice, for the package and for shooting, in units of the rod; a trail; the kinds of
    contact on it.
    """

    surface: vb.surfaces.Surface
    level: Level
    trail: vb.Trail
    kinds: str
    rod: vb.Rod = vb.Rod.unit()


def line(start: list[float], stop: list[float], axis: list[float]) -> vb.Trail:
    return vb.Trail.line(
        start=np.array(start), stop=np.array(stop), count=COUNT, axis=np.array(axis)
    )


def sphere() -> Case:
    """The flank meets a sphere on its near side."""
    center = np.array([0.0, 0.0, 0.7])
    surface = vb.surfaces.Sphere(center=center, radius=0.4)
    return Case(
        surface,
        quadric(center, np.full(3, 0.4)),
        line([0.9, 0.1, 0.1], [-0.1, 0.15, 0.0], [-0.1, 0.1, 1.0]),
        "TANGENTIAL",
    )


def wire_on_a_ball() -> Case:
    """50 mm of spring steel, 0.5 mm thick, on a ball of 60 mm, in SI units."""
    center, wire = (
        np.array([0.0, 0.0, 0.06]),
        vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9),
    )
    surface = vb.surfaces.Sphere(center=center, radius=0.03)
    return Case(
        surface,
        quadric(center, np.full(3, 0.03)),
        line([0.06, 0.01, 0.0], [-0.04, 0.01, 0.0], [0.0, 0.0, 1.0]),
        "TIP TANGENTIAL",
        wire,
    )


def placed_paraboloid() -> Case:
    surface = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4).placed(
        rotation=TURN, translation=SHIFT
    )
    start, stop = TURN.apply([[1.2, 0.2, 0.0], [-0.9, 0.15, 0.0]]) + SHIFT
    trail = line(start.tolist(), stop.tolist(), TURN.apply([-0.1, 0.15, 1.0]).tolist())
    return Case(surface, paraboloid(0.5, 1.0, 0.4).placed(TURN, SHIFT), trail, "TIP TANGENTIAL")


def ellipsoid_and_a_turning_clamp() -> Case:
    center, semi_axes = np.array([0.1, 0.0, 0.7]), np.array([0.6, 0.5, 0.4])
    turning = Rotation.from_rotvec(
        np.linspace(-0.2, 0.2, COUNT)[:, None] * [0.1, 1.0, 0.2]
    ) * Rotation.from_euler("z", 0.3)
    trail = vb.Trail(np.linspace([1.1, 0.15, 0.0], [0.2, 0.1, 0.1], COUNT), turning.as_quat())
    return Case(
        vb.surfaces.Ellipsoid(center=center, semi_axes=semi_axes).placed(),
        quadric(center, semi_axes),
        trail,
        "TANGENTIAL",
    )


def elliptic_cylinder() -> Case:
    center = np.array([0.0, 0.0, 1.1])
    surface = vb.surfaces.EllipticCylinder(center=center, semi_axes=np.array([0.7, 0.5]))
    return Case(
        surface,
        quadric(center, np.array([0.7, np.inf, 0.5])),
        line([1.0, 0.3, 0.0], [0.0, 0.2, 0.0], [0.1, 0.4, 1.0]),
        "TIP",
    )


def wavy_height_field() -> Case:
    """The trail stops short of a fold."""
    surface = vb.surfaces.HeightField(
        lambda x, y: 0.5 + 0.4 * x * x + 0.3 * x * y + 0.7 * y * y + 0.05 * jnp.sin(4 * x)
    )
    level = height_field(
        lambda x, y: 0.5 + 0.4 * x * x + 0.3 * x * y + 0.7 * y * y + 0.05 * np.sin(4 * x),
        lambda x, y: (0.8 * x + 0.3 * y + 0.2 * np.cos(4 * x), 0.3 * x + 1.4 * y),
    )
    return Case(
        surface,
        level,
        line([1.3, 0.35, 0.0], [-0.3, 0.3, 0.05], [0.05, -0.1, 1.0]),
        "TIP TANGENTIAL",
    )


CASES = (
    sphere,
    wire_on_a_ball,
    placed_paraboloid,
    ellipsoid_and_a_turning_clamp,
    elliptic_cylinder,
    wavy_height_field,
)


class Pair(NamedTuple):
    """One case scanned, and shot."""

    case: Case
    scan: vb.Scan
    shot: list[Equilibrium | None]

    @property
    def contacts(self) -> list[int]:
        """Positions at which the scan found a contact."""
        return np.flatnonzero(self.scan.in_contact).tolist()

    def in_model_units(self, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Contact point, f0, m0 and clamp of a position, in L, EI/L² and EI/L."""
        rod, reactions = self.case.rod, self.scan.reactions
        stiffness, length = rod.bending_stiffness, rod.length
        force, moment = (
            reactions.force[i] * length**2 / stiffness,
            reactions.moment[i] * length / stiffness,
        )
        return self.scan.point[i] / length, force, moment, self.case.trail.position[i] / length


@pytest.fixture(scope="module", params=CASES, ids=lambda case: case.__name__)
def pair(request: pytest.FixtureRequest) -> Pair:
    case = request.param()
    length = case.rod.length
    tangents = np.array([clamp_tangent(q) for q in case.trail.orientation])
    shot = follow(case.level.scaled(length), case.trail.position / length, tangents)
    return Pair(case, vb.scan(case.rod, case.surface, case.trail), shot)


def test_both_find_the_same_kinds_of_contact(pair: Pair) -> None:
    kind = vb.ContactKind
    shot = [
        kind.NONE if s is None else kind.TIP if s.arc_length == 1 else kind.TANGENTIAL
        for s in pair.shot
    ]
    np.testing.assert_array_equal(pair.scan.kind, shot)
    assert {kind(k).name for k in shot} == {"NONE", *pair.case.kinds.split()}
    assert np.all(pair.scan.status == vb.Status.OK)


def test_every_field_agrees_with_shooting(pair: Pair) -> None:
    for i in pair.contacts:
        point, force, moment, _ = pair.in_model_units(i)
        shot, scan = pair.shot[i], pair.scan
        assert shot is not None
        found = np.concatenate(
            [point, scan.normal[i], [scan.arc_length[i] / pair.case.rod.length], force, moment]
        )
        expected = np.concatenate(
            [
                shot.point,
                shot.normal,
                [shot.arc_length],
                -shot.force * shot.normal,
                -shot.base_moment,
            ]
        )
        np.testing.assert_allclose(found, expected, rtol=0, atol=TOLERANCE)
        np.testing.assert_allclose(scan.contact_tangent[i], shot.tangent, rtol=0, atol=TOLERANCE)


def test_returned_reactions_bend_the_rod_to_the_returned_contact(pair: Pair) -> None:
    """Integrated with f0 and m0 alone, the rod is first free of moment at the arc length, and there
    at the point.
    """
    for i in pair.contacts:
        point, force, moment, clamp = pair.in_model_units(i)
        s = np.linspace(0, pair.scan.arc_length[i] / pair.case.rod.length, 12)
        along = rod_along(clamp, clamp_tangent(pair.case.trail.orientation[i]), -moment, -force, s)
        np.testing.assert_allclose(along[-1, 6:9], 0, atol=TOLERANCE)
        np.testing.assert_allclose(along[-1, :3], point, rtol=0, atol=TOLERANCE)
        assert np.all(along[:-1, 6:9] @ -moment > 0)
        assert along[-1, 9] * pair.case.rod.moment_scale == pytest.approx(
            pair.scan.energy[i], abs=TOLERANCE * pair.case.rod.moment_scale
        )


def test_returned_contact_obeys_the_contact_law(pair: Pair) -> None:
    """The point on the object, the force along its outward normal, the rod tangent to it or
    touching with its tip.
    """
    level = pair.case.level.scaled(pair.case.rod.length)
    for i in pair.contacts:
        point, force, _, _ = pair.in_model_units(i)
        normal = level.normal(point)
        assert level.value(point) / np.linalg.norm(level.gradient(point)) == pytest.approx(
            0, abs=TOLERANCE
        )
        np.testing.assert_allclose(-force, np.linalg.norm(force) * normal, rtol=0, atol=TOLERANCE)
        lift, spare = (
            -pair.scan.contact_tangent[i] @ normal,
            1 - pair.scan.arc_length[i] / pair.case.rod.length,
        )
        assert min(lift, spare) == pytest.approx(0, abs=TOLERANCE)
        assert max(lift, spare) > -TOLERANCE


def test_elastic_line_is_the_integrated_rod(pair: Pair) -> None:
    """Bent up to the contact, straight beyond."""
    for i in pair.contacts[::6]:
        _, force, moment, clamp = pair.in_model_units(i)
        contact = pair.scan.arc_length[i] / pair.case.rod.length
        s = np.linspace(0, 1, 41)
        end, bent = s[s >= contact], s[s < contact]
        along = rod_along(
            clamp,
            clamp_tangent(pair.case.trail.orientation[i]),
            -moment,
            -force,
            np.append(bent, contact),
        )
        expected = np.vstack(
            [along[:-1, :3], along[-1, :3] + (end - contact)[:, None] * along[-1, 3:6]]
        )
        np.testing.assert_allclose(
            pair.scan.elastic_line(i, 41) / pair.case.rod.length, expected, rtol=0, atol=TOLERANCE
        )
