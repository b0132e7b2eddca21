"""Sweeps along every primitive: an equilibrium at every position, with the whole elastic line
outside, that knows neither left from right nor where it is in space.

Edges are grown by a radius, as a rod of that radius has it; a sharp edge has no normal.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.surfaces import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Offset,
    Sphere,
    Superquadric,
    Surface,
    Torus,
    Union,
)

COUNT = 121
TURN, SHIFT = Rotation.from_rotvec([0.7, -1.1, 0.4]), np.array([0.4, -0.3, 0.8])
NOT_TURNED = Rotation.identity()
# Trails in x at these y, from 1.2 to the last x: ahead of a snap, or behind detachment.
SCENES: dict[str, tuple[Callable[[float], Surface], float, float]] = {
    # In all of them y is multiplied by ±1: the mirror in the plane y = 0.
    "box": (
        lambda m: Offset(
            Box((0, 0, 0), (0.2, 0.6, 0.2)).placed(
                Rotation.from_rotvec([0.4 * m, 0.3, 0.2 * m]), (0, 0, 0.95)
            ),
            0.03,
        ),
        0.13,
        0.0,
    ),
    "cylinder": (
        lambda m: Offset(Cylinder((0, 0, 0.85), (0.1, 0.05 * m, 1), 0.25, 0.5), 0.02),
        0.13,
        -1.0,
    ),
    "capsule": (lambda m: Capsule((0, 0, 0.85), (0.3, m, 0.2), 0.2, 0.5), 0.3, -1.0),
    "cone": (lambda m: Offset(Cone((0, 0, 1.1), (0.1, 0, -1), 0.4, 0.5), 0.02), 0.13, -1.0),
    "torus": (lambda m: Torus((0, 0, 0.8), (0.2, 0.1 * m, 1), 0.35, 0.1), -0.2, -1.0),
    "superquadric": (lambda m: Superquadric((0, 0, 0.85), (0.3, 0.4, 0.25), (0.5, 0.7)), 0.3, -1.0),
    "union": (
        lambda m: Union(
            [Sphere((0.25, 0, 0.9), 0.25), Capsule((-0.2, 0, 0.95), (0.2, m, 0), 0.2, 0.3)]
        ),
        -0.2,
        -0.97,
    ),
}
ALL = pytest.mark.parametrize("name", SCENES)


@cache
def swept(name: str, mirror: float = 1.0, turn: Rotation = NOT_TURNED) -> vb.Scan:
    build, side, last = SCENES[name]
    shift = SHIFT if turn is TURN else np.zeros(3)
    position = np.linspace((1.2, mirror * side, 0), (last, mirror * side, 0), COUNT)
    trail = vb.Trail(turn.apply(position) + shift, turn)
    return vb.scan(vb.Rod.unit(), build(mirror).placed(turn, shift), trail)


@ALL
def test_every_position_is_an_equilibrium_on_the_surface(name: str) -> None:
    scan = swept(name)
    assert np.all(scan.status == vb.Status.OK)
    touching = scan.in_contact
    assert touching.sum() > 15
    assert scan.residual[touching].max() < 1e-12
    np.testing.assert_allclose(scan.surface.distances(scan.point[touching]), 0, atol=1e-13)
    np.testing.assert_allclose(
        scan.normal[touching], scan.surface.normal(scan.point[touching]), rtol=0, atol=1e-12
    )
    assert scan.events[0].kind == vb.EventKind.FIRST_CONTACT


@ALL
def test_the_whole_elastic_line_stays_outside(name: str) -> None:
    scan = swept(name)
    for index in range(COUNT):
        line = scan.elastic_line(index, count=1501)
        assert scan.surface.distances(line).min() > -1e-9
        if scan.in_contact[index]:
            # It touches where it is said to, and the contact pushes the rod outwards.
            assert np.linalg.norm(line - scan.point[index], axis=1).min() < 1e-3
            assert -scan.reactions.force[index] @ scan.normal[index] > 0


@ALL
def test_a_mirrored_sweep_is_the_mirror_image(name: str) -> None:
    scan, image, flip = swept(name), swept(name, -1.0), np.array([1.0, -1.0, 1.0])
    np.testing.assert_array_equal(scan.kind, image.kind)
    np.testing.assert_allclose(image.point, scan.point * flip, rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        image.reactions.force, scan.reactions.force * flip, rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(
        image.reactions.moment, scan.reactions.moment * -flip, rtol=0, atol=1e-9
    )


@ALL
def test_a_moved_sweep_is_moved(name: str) -> None:
    scan, moved = swept(name), swept(name, turn=TURN)
    np.testing.assert_array_equal(scan.kind, moved.kind)
    np.testing.assert_allclose(moved.point, TURN.apply(scan.point) + SHIFT, rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        moved.reactions.force, TURN.apply(scan.reactions.force), rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(moved.arc_length, scan.arc_length, rtol=0, atol=1e-10)
    assert [event.kind for event in moved.events] == [event.kind for event in scan.events]


@pytest.mark.parametrize(("name", "radius"), [("box", 0.03), ("cylinder", 0.02), ("cone", 0.02)])
def test_the_rods_skin_touches_the_object_itself(name: str, radius: float) -> None:
    scan = swept(name)
    grown = SCENES[name][0](1.0)
    assert isinstance(grown, Offset)
    point, normal = scan.point[scan.in_contact], scan.normal[scan.in_contact]
    foot = grown.foot(point)
    np.testing.assert_allclose(grown.surface.distances(foot), 0, atol=1e-13)
    np.testing.assert_allclose(foot, point - radius * normal, rtol=0, atol=1e-12)


def test_the_inverse_finds_the_contacts_again() -> None:
    """From reactions alone, on an edge as on a face."""
    for name in ("box", "cylinder", "torus"):
        scan = swept(name)
        found = vb.reconstruct(vb.Rod.unit(), scan.reactions)
        clear = scan.in_contact & (np.linalg.norm(scan.reactions.force, axis=1) > 1e-3)
        np.testing.assert_allclose(found.point[clear], scan.point[clear], rtol=0, atol=1e-6)
