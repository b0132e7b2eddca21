"""A box that is exactly level with the tip, coplanar with the trail or parallel to the rod: solved,
or said so, and never lost.
"""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

import vibrissa as vb
from vibrissa.surfaces import Box, Mesh

LENGTH, RADIUS = 0.05, 0.25e-3
ROD = vb.Rod.cylinder(length=LENGTH, radius=RADIUS, youngs_modulus=206e9)
HALF = np.array([0.010, 0.008, 0.010])
COUNT = 61
LEVEL = {"level": 0.0, "less a radius": -RADIUS, "a nanometre in": -1e-9, "half way": -0.01}
WAYS = {
    "along x": ((20, 1), (-20, 1)),
    "centred": ((20, 0), (-20, 0)),
    "along y": ((2, 20), (2, -20)),
    "oblique": ((20, 13), (-20, -11)),
    "over the corners": ((20, 16), (-20, -16)),
    "side level with the rod": ((20, 8), (-20, 8)),
    "skin along the side": ((20, 8.25), (-20, 8.25)),
    "begun in contact": ((9, 1), (-20, 1)),
    "begun touching": ((10.25, 1), (-20, 1)),
}
# Those that differ most, as each takes a search or two.
CHOSEN = [
    *[("level", way) for way in WAYS],
    *[("less a radius", way) for way in ("centred", "oblique", "over the corners")],
    ("a nanometre in", "along x"),
    ("half way", "over the corners"),
]


def center(height: float) -> np.ndarray:
    """Of a box whose lower face is this much above the tip."""
    return np.array([0, 0, LENGTH + HALF[2] + height])


@cache
def swept(height: float, way: str) -> vb.Scan:
    start, stop = (np.append(end, 0.0) / 1000 for end in WAYS[way])
    trail = vb.Trail(np.linspace(start, stop, COUNT), (0.0, 0.0, 0.0, 1.0))
    return vb.scan(
        ROD, Box((0, 0, 0), HALF).placed(translation=center(height)), trail, finite_radius=True
    )


@pytest.mark.parametrize(("level", "way"), CHOSEN)
def test_every_row_is_an_equilibrium_or_says_what_is_degenerate(level: str, way: str) -> None:
    scan = swept(LEVEL[level], way)
    assert not np.isin(scan.status, [vb.Status.NOT_CONVERGED, vb.Status.NO_EQUILIBRIUM]).any()
    assert np.isfinite(scan.energy[scan.status == vb.Status.OK]).all()
    touching = scan.in_contact
    assert scan.residual[touching].max(initial=0) < 1e-9
    assert scan.depth[touching].max(initial=0) < 1e-9
    assert sum(event.kind == vb.EventKind.SNAP for event in scan.events) <= 3
    assert np.isfinite(
        [[event.parameter, *event.clamp, *event.point] for event in scan.events]
    ).all()


@pytest.mark.parametrize("way", ["centred", "oblique"])
def test_on_the_face_the_rod_is_the_buckled_column_and_keeps_its_side(way: str) -> None:
    """A column under a load along its axis: √f L = K(k), and the tip lies at (2E/K − 1) L
    (Timoshenko & Gere, Theory of Elastic Stability, 2.7).
    """
    scan = swept(-RADIUS, way)
    on_face = scan.status == vb.Status.HEAD_ON
    assert on_face.sum() > 10
    shortened = 1 - 2 * RADIUS / LENGTH
    m = brentq(lambda m: 2 * ellipe(m) / ellipk(m) - 1 - shortened, 1e-6, 0.5, xtol=1e-15)
    expected = np.broadcast_to([0, 0, -(ellipk(m) ** 2) * ROD.force_scale], (on_face.sum(), 3))
    np.testing.assert_allclose(-scan.reactions.force[on_face], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(scan.arc_length[on_face], LENGTH, rtol=1e-12)
    aside = (scan.point - scan.trail.position)[on_face]
    np.testing.assert_allclose(aside, np.broadcast_to(aside[0], aside.shape), atol=1e-9)


def test_touching_without_force_is_no_contact() -> None:
    scan = swept(RADIUS, "along x")
    assert not scan.in_contact.any()
    assert np.all(scan.status == vb.Status.OK)
    assert not scan.events


def test_the_box_of_twelve_triangles_is_the_same_object_to_the_rod() -> None:
    """Where its centre line may run, across faces, diagonals, edges and corners alike, the level is
    that of the box: so are contacts, normals and forces.
    """
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    mesh, box = Mesh(center(0.0) + HALF * corners, np.array(faces)), Box(center(0.0), HALF)
    places = np.array(
        [
            [1, 0.2, -1],
            [0.3, 1, -1],
            [1, 1, -1],
            [0.1, 0.3, -1],
            [0.5, 0.5, -1],
            [1, 0.3, 0.2],
            [-0.2, 0.2, -1],
            [1, 1, 0.3],
        ]
    )
    away = np.random.default_rng(1).uniform(0, RADIUS, (50, 1, 3)) * np.sign(places)
    centre_line = (center(0.0) + HALF * places + away).reshape(-1, 3)
    np.testing.assert_allclose(
        mesh.levels(centre_line), box.distances(centre_line), rtol=0, atol=1e-15
    )
