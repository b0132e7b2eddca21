"""Meshes against the exact solids they were made of."""

import numpy as np
import pytest
import trimesh

import vibrissa as vb
from vibrissa.surfaces import Box, Ellipsoid, Mesh
from vibrissa.surfaces.mesh.creases import sheets
from vibrissa.surfaces.mesh.sampling import mesh_levels

UNIT = vb.Rod.unit()
CENTER, SEMI_AXES = np.array([0.0, 0.0, 1.15]), np.array([0.6, 0.5, 0.55])
TRAIL = vb.Trail.raster(
    start=(1.1, -0.31, 0), stop=(-1.1, -0.3, 0), count=91, step=(0, 0.17, 0), trails=4
)


def ball(subdivisions: int) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    mesh.apply_scale(SEMI_AXES)
    mesh.apply_translation(CENTER)
    return mesh


def chordal_error(mesh: trimesh.Trimesh, exact: vb.surfaces.Surface) -> float:
    """How far the middles of the triangles lie inside the solid at most."""
    return float(-exact.distances(mesh.triangles_center).min())


def compared(surface: vb.surfaces.Surface, exact: vb.surfaces.Surface) -> np.ndarray:
    """Distances between contacts on both, where both are sound."""
    # Placed as other tests have it: of a kind that is compiled once.
    ours, theirs = (vb.scan(UNIT, solid, TRAIL) for solid in (surface, exact.placed()))
    both = (
        ours.in_contact
        & theirs.in_contact
        & (ours.status == vb.Status.OK)
        & (theirs.status == vb.Status.OK)
    )
    assert np.mean(both[theirs.in_contact]) > 0.97
    return np.linalg.norm(ours.point - theirs.point, axis=-1)[both]


@pytest.fixture(scope="module")
def errors() -> dict[int, tuple[float, float]]:
    """Largest error of the contact and the chordal error, by number of subdivisions."""
    exact = Ellipsoid(CENTER, SEMI_AXES)
    found = {}
    for subdivisions in (2, 4):
        mesh = ball(subdivisions)
        found[subdivisions] = (
            compared(Mesh(mesh.vertices, mesh.faces), exact).max(),
            chordal_error(mesh, exact),
        )
    return found


def test_contacts_on_the_mesh_of_an_ellipsoid_are_within_twice_its_chordal_error(
    errors: dict[int, tuple[float, float]],
) -> None:
    for error, chordal in errors.values():
        assert error < 2 * chordal


def test_the_error_falls_faster_than_the_chordal_one(
    errors: dict[int, tuple[float, float]],
) -> None:
    """Halved edges quarter the chordal error; the smooth surface through the vertices does better."""
    (coarse, coarse_chordal), (fine, fine_chordal) = errors[2], errors[4]
    assert coarse_chordal / fine_chordal == pytest.approx(16, rel=0.2)
    assert coarse / fine > 30


def test_the_level_is_a_distance_near_the_mesh() -> None:
    mesh = ball(3)
    surface, exact = Mesh(mesh.vertices, mesh.faces), Ellipsoid(CENTER, SEMI_AXES)
    rng = np.random.default_rng(5)
    direction = rng.normal(size=(500, 3))
    foot = CENTER + SEMI_AXES * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    points = foot + rng.uniform(-0.04, 0.08, (500, 1)) * exact.normal(foot)
    chordal = chordal_error(mesh, exact)
    np.testing.assert_allclose(
        surface.levels(points), exact.distances(points), rtol=0, atol=chordal
    )
    assert np.min(
        np.sum(surface.normal(points) * exact.normal(exact.nearest(points)), axis=1)
    ) > np.cos(0.02)


def test_edges_stay_sharp() -> None:
    """A box of triangles, turned, is the box: distances near it, inside and outside, from faces,
    edges and corners.
    """
    half = np.array([0.4, 0.3, 0.2])
    mesh = trimesh.creation.box(2 * half).subdivide()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], CENTER))
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], CENTER)
    surface = Mesh(mesh.vertices, mesh.faces)
    rng = np.random.default_rng(6)
    own = np.sign(rng.uniform(-1, 1, (4000, 3))) * half + rng.uniform(-0.02, 0.02, (4000, 3))
    flat = rng.uniform(size=(4000, 3)) < 0.5
    own = np.where(flat, rng.uniform(-1, 1, (4000, 3)) * half, own)
    exact = Box((0, 0, 0), half).distances(own)
    near = np.abs(exact) < 0.02
    points = trimesh.transformations.transform_points(own[near], turn)
    np.testing.assert_allclose(surface.levels(points), exact[near], rtol=0, atol=1e-11)


def test_levels_are_those_of_the_triangle_below_from_wherever_one_starts() -> None:
    """A grid coarser than the mesh hands its middles a triangle that is several edges away."""
    mesh, exact = ball(4), Ellipsoid(CENTER, SEMI_AXES)
    sheet = sheets(mesh.vertices, mesh.faces, 0.7)
    rng = np.random.default_rng(7)
    below = rng.integers(0, len(mesh.faces), 200)
    points = (
        mesh.triangles_center[below] + rng.uniform(-0.01, 0.01, (200, 1)) * mesh.face_normals[below]
    )
    apart = np.linalg.norm(mesh.triangles_center - points[:, None], axis=2)
    away = np.argmin(np.abs(apart - 0.25), axis=1)
    found = mesh_levels(sheet, points, away)
    np.testing.assert_allclose(found, mesh_levels(sheet, points, below), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        found, exact.distances(points), rtol=0, atol=0.1 * chordal_error(mesh, exact)
    )
