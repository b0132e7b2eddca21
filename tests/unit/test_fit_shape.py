"""Surfaces through contacts with known errors: places, normals, intervals, outliers, words."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from touched import NORMAL, POINT, on_surface, rings

import vibrissa as vb
from vibrissa.shape.area import vertex_areas
from vibrissa.shape.mesh import _touched
from vibrissa.shape.outliers import inside_out
from vibrissa.shape.sites import gathered

ELLIPSOID = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.026, 0.021, 0.017))
BLOCK = vb.surfaces.Offset(
    vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.016, 0.013, 0.012)), 0.004
)


def samples(surface: vb.surfaces.Surface, count: int = 400, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return on_surface(surface, 0.02 * rng.normal(size=(count, 3)) / 3**0.5 + 1e-4)


SURFACES = {"ellipsoid": ELLIPSOID, "block": BLOCK}


@cache
def fitted(name: str, sweeps: int = 16, seed: int = 3) -> vb.Shape:
    """Kept, as a fit takes seconds."""
    return vb.fit_shape(rings(SURFACES[name], np.random.default_rng(seed), sweeps=sweeps))


@pytest.fixture(scope="module")
def ellipsoid() -> vb.Shape:
    return fitted("ellipsoid")


@pytest.mark.parametrize(
    ("name", "mean", "normals"), [("ellipsoid", 0.012e-3, 0.3), ("block", 0.06e-3, 1.0)]
)
def test_surface_is_within_its_interval(name, mean, normals):
    surface, shape = SURFACES[name], fitted(name)
    points = samples(surface)
    held = []
    for each in (shape, fitted(name, seed=4), fitted(name, seed=5)):
        away, deviation = np.abs(each.distance(points)), each.deviation(points)
        assert away.mean() < mean
        assert np.median(deviation) < 0.03e-3
        held.append(np.mean(away < 1.96 * deviation))
    assert 0.93 < np.mean(held) < 0.99
    cosine = np.sum(shape.normal(points) * surface.normal(points), axis=1)
    assert np.degrees(np.arccos(np.median(cosine))) < normals


def test_distance_is_euclidean_far_from_the_surface(ellipsoid):
    points = samples(ELLIPSOID, 60) * 1.5
    exact = ELLIPSOID.distances(points)
    np.testing.assert_allclose(ellipsoid.distance(points), exact, atol=0.1e-3)
    assert ellipsoid.distance((0, 0, 0)) < -0.015
    feet = ellipsoid.nearest(points)
    np.testing.assert_allclose(ELLIPSOID.distances(feet), 0, atol=0.06e-3)
    away = [[0.3, 0, 0], [-2, 5, 1], [0, 0.09, -0.09]]
    np.testing.assert_allclose(ellipsoid.distance(away), ELLIPSOID.distances(away), atol=0.2e-3)


def test_gradient_is_that_of_the_distance(ellipsoid):
    points, step = samples(ELLIPSOID, 5) * 1.02, 1e-5
    for axis in np.eye(3):
        change = ellipsoid.distance(points + step * axis) - ellipsoid.distance(points - step * axis)
        slope = ellipsoid.gradient(points) @ axis
        np.testing.assert_allclose(change / (2 * step), slope, atol=1e-4)


def test_mesh_lies_on_the_surface_and_is_closed(ellipsoid):
    mesh = ellipsoid.mesh(extrapolate=True)
    solid = mesh.to_trimesh()
    assert solid.is_watertight
    assert solid.is_winding_consistent
    exact = 4 / 3 * np.pi * np.prod([0.026, 0.021, 0.017])
    assert solid.volume == pytest.approx(exact, rel=0.01)
    assert np.abs(ELLIPSOID.distances(mesh.vertices)).max() < 0.1e-3
    assert np.all(ellipsoid.mesh().deviation <= 0.01 * ellipsoid.extent)


def test_the_part_that_is_seen_is_that_of_the_whole_mesh():
    """It is cut near contacts only, as a surface that bends is not known far from them."""
    shape = vb.fit_shape(rings(ELLIPSOID, np.random.default_rng(0), sweeps=2))
    step = shape.extent / 20
    mesh, whole = shape.mesh(step), shape.mesh(step, extrapolate=True)
    seen = whole.seen_part()
    assert len(seen.vertices) < 0.7 * len(whole.vertices)
    np.testing.assert_allclose(mesh.vertices, seen.vertices, atol=1e-9)
    np.testing.assert_array_equal(mesh.faces, seen.faces)


def test_surface_can_be_scanned(ellipsoid):
    rod = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
    trail = vb.Trail.line(start=(0.035, 0.003, -0.05), stop=(-0.035, 0.003, -0.05), count=61)
    scan = vb.scan(rod, ellipsoid.surface(), trail)
    exact = vb.scan(rod, ELLIPSOID, trail)
    touching = scan.in_contact & exact.in_contact
    assert touching.sum() > 30
    assert np.array_equal(scan.kind, exact.kind)
    force = scan.reactions.force[touching] - exact.reactions.force[touching]
    assert np.abs(force).max() < 0.02 * np.abs(exact.reactions.force).max()
    assert np.abs(ELLIPSOID.distances(scan.point[touching])).max() < 0.1e-3


def test_outliers_are_named_and_do_no_harm():
    rng = np.random.default_rng(8)
    clean = rings(ELLIPSOID, rng)
    wrong = rng.random(len(clean)) < 0.05
    point = clean.point.copy()
    point[wrong] += rng.normal(0, 2e-3, (wrong.sum(), 3))
    shape = vb.fit_shape(
        vb.Contacts(
            point, clean.normal, clean.covariance, clean.normal_covariance, sweep=clean.sweep
        )
    )
    off = wrong & (np.abs(ELLIPSOID.distances(point)) > 0.3e-3)
    assert shape.outlier[off].mean() > 0.9
    assert shape.outlier[~wrong].mean() < 0.01
    assert np.abs(shape.distance(samples(ELLIPSOID))).mean() < 0.012e-3


def test_far_from_contacts_little_is_known_and_missing_rods_say_more():
    whole = rings(ELLIPSOID, np.random.default_rng(2), sweeps=12)
    near = vb.fit_shape(whole[whole.point[:, 2] < 0.004])
    points = samples(ELLIPSOID)
    far = points[:, 2] > 0.010
    assert np.median(near.deviation(points[far])) > 10 * np.median(near.deviation(points[~far]))
    # Rods that pass by all around, a millimetre above the surface.
    feet = points[points[:, 2] > 0]
    along = np.cross(ELLIPSOID.normal(feet), (0.3, 1, 0.2))
    along /= np.linalg.norm(along, axis=1)[:, None]
    middle = feet + 1e-3 * ELLIPSOID.normal(feet)
    lines = middle[:, None] + np.linspace(-0.02, 0.02, 41)[:, None] * along[:, None]
    lines = lines[(ELLIPSOID.distances(lines) > 0).all(axis=1)]
    known = vb.fit_shape(whole[whole.point[:, 2] < 0.004], swept=lines)
    away = [np.abs(shape.distance(points[far])) for shape in (near, known)]
    assert away[1].mean() < 0.7 * away[0].mean()
    assert np.mean(away[1] < 1.96 * known.deviation(points[far])) > 0.93
    assert (known.distance(lines.reshape(-1, 3)) > -0.3e-3).all()


def test_rods_that_cannot_have_missed_are_named():
    """A rod through the middle is at most the smallest semi-axis deep, and said to be half of that
    at least.
    """
    given = rings(ELLIPSOID, np.random.default_rng(0), sweeps=8)
    through = np.linspace([-0.05, 0, 0], [0.05, 0, 0], 60)[None]
    (line,) = vb.fit_shape(given, swept=through).warnings
    depth = float(line.removeprefix("rods that missed are up to ").split()[0])
    assert 0.0085 < depth < 0.0175
    assert not vb.fit_shape(given, swept=through + [0, 0, 0.0175]).warnings


def test_of_very_many_contacts_some_are_used(monkeypatch):
    from vibrissa.shape import sites

    given = rings(ELLIPSOID, np.random.default_rng(0))
    monkeypatch.setattr(sites, "_LARGEST", 200)
    shape = vb.fit_shape(given)
    assert np.array_equal(np.flatnonzero(shape.used), np.arange(0, len(given), 4))
    assert shape.warnings[0] == "one contact in 4 is used, as 160 tell as much as all"
    assert np.abs(shape.distance(samples(ELLIPSOID, 100))).mean() < 0.05e-3


def test_deviations_grow_where_sweeps_disagree_with_the_surface_of_the_others():
    """Three girths of a block, each the only one along two of its sides."""
    given = rings(BLOCK, np.random.default_rng(2), sweeps=3)
    shape, points = vb.fit_shape(given), samples(BLOCK)
    assert shape.level.doubt > 1.2
    sure = replace(shape, level=shape.level._replace(doubt=1.0))
    assert (shape.deviation(points) > sure.deviation(points)).all()
    away = np.abs(shape.distance(points))
    assert np.mean(away < 1.96 * shape.deviation(points)) > 0.93
    assert fitted("block").level.doubt < 1.2


def test_units_do_not_matter():
    given = rings(ELLIPSOID, np.random.default_rng(3), sweeps=6)
    scaled = vb.Contacts(
        1000 * given.point, given.normal, 1e6 * given.covariance, given.normal_covariance,
        sweep=given.sweep,
    )  # fmt: skip
    points = samples(ELLIPSOID, 50)
    small, large = fitted("ellipsoid", sweeps=6), vb.fit_shape(scaled)
    np.testing.assert_allclose(
        large.distance(1000 * points), 1000 * small.distance(points), atol=1e-4
    )
    np.testing.assert_allclose(
        large.deviation(1000 * points), 1000 * small.deviation(points), rtol=1e-3
    )


def test_turning_the_object_turns_the_surface():
    from scipy.spatial.transform import Rotation

    given, turn = rings(ELLIPSOID, np.random.default_rng(3), sweeps=6), Rotation.random(rng=1)
    moved = vb.Contacts(
        turn.apply(given.point) + 0.1, turn.apply(given.normal), given.covariance,
        turn.as_matrix() @ given.normal_covariance @ turn.as_matrix().T, sweep=given.sweep,
    )  # fmt: skip
    points = samples(ELLIPSOID, 50)
    one, other = fitted("ellipsoid", sweeps=6), vb.fit_shape(moved)
    # Pools are cells of a lattice, which turning changes.
    difference = other.distance(turn.apply(points) + 0.1) - one.distance(points)
    assert np.abs(difference).max() < 0.5 * np.max(one.deviation(points))


def test_contacts_without_covariances():
    given = rings(ELLIPSOID, np.random.default_rng(5))
    shape = vb.fit_shape(vb.Contacts(given.point, given.normal, sweep=given.sweep))
    away = np.abs(shape.distance(samples(ELLIPSOID)))
    assert away.mean() < 0.02e-3
    # Errors that neighbours share are partly taken for the surface's own.
    assert np.mean(away < 1.96 * shape.deviation(samples(ELLIPSOID))) > 0.75


def test_rows_without_a_sound_contact_are_left_out():
    given = rings(ELLIPSOID, np.random.default_rng(6), sweeps=4)
    point, kind, status = given.point.copy(), np.ones(len(given), int), np.zeros(len(given), int)
    point[::7], kind[1::7], status[2::7] = np.nan, vb.ContactKind.NONE, vb.Status.AMBIGUOUS
    point[1::7] += 1.0
    point[2::7] += 1.0
    rows = {"covariance": given.covariance, "normal_covariance": given.normal_covariance}
    shape = vb.fit_shape(
        vb.Contacts(point, given.normal, **rows, sweep=given.sweep, kind=kind, status=status)
    )
    used = np.isfinite(point).all(axis=1) & (kind > 0) & (status == 0)
    assert shape.sites.size.sum() == used.sum()
    assert len(shape.outlier) == len(given)
    assert not shape.outlier[~used].any()


def test_contacts_that_know_nothing_of_their_normals_say_nothing():
    """A rod that hardly touches: contacts tens of millimetres off, as their covariances say."""
    given = rings(ELLIPSOID, np.random.default_rng(3), sweeps=6)
    far = np.linspace([0.03, 0, 0], [0.07, 0.01, 0], 30)
    along = far[-1] - far[0]
    lost = vb.Contacts(
        far, np.tile([0.0, 0, 1], (30, 1)),
        np.tile(0.25 * np.outer(along, along), (30, 1, 1)) + 1e-12 * np.eye(3),
        np.tile(1.5**2 / 2 * np.diag([1.0, 1, 0]), (30, 1, 1)),
    )  # fmt: skip
    plain, shape = fitted("ellipsoid", sweeps=6), vb.fit_shape([given, lost])
    points = samples(ELLIPSOID, 50)
    np.testing.assert_allclose(shape.distance(points), plain.distance(points), atol=1e-9)
    assert not shape.outlier.any() and not shape.warnings
    with pytest.raises(ValueError, match="0 of 30 rows hold a contact with status OK and a known"):
        vb.fit_shape(lost)


def test_a_sweep_that_contradicts_the_others_is_named():
    """By its number, whether or not sweeps before it have contacts."""
    given = rings(ELLIPSOID, np.random.default_rng(10))
    moved = np.where((given.sweep == 7)[:, None], [0, 0, 0.4e-3], 0) + given.point
    moved[given.sweep == 2] = np.nan
    shape = vb.fit_shape(
        vb.Contacts(
            moved, given.normal, given.covariance, given.normal_covariance, sweep=given.sweep
        )
    )
    assert [line[:7] for line in shape.warnings] == ["sweep 7"]
    assert np.abs(shape.distance(samples(ELLIPSOID))).mean() < 0.02e-3


def test_two_objects_are_told():
    one = rings(ELLIPSOID, np.random.default_rng(0), sweeps=4)
    other = vb.Contacts(
        one.point + np.array([0.12, 0, 0]), one.normal, one.covariance, one.normal_covariance
    )
    assert any("2 groups" in line for line in vb.fit_shape([one, other]).warnings)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_contacts(count):
    given = rings(ELLIPSOID, np.random.default_rng(0), sweeps=1)[:count]
    with pytest.raises(ValueError, match=f"contacts: {count} of {count} rows .* at least 3"):
        vb.fit_shape(given)


def test_contacts_that_are_not_finite():
    nothing = np.full((5, 3), np.nan)
    with pytest.raises(ValueError, match="contacts: 0 of 5 rows hold a contact"):
        vb.fit_shape(vb.Contacts(nothing, nothing))


@pytest.mark.parametrize("far", [0.1, 10.0, 1e200])
def test_a_contact_far_from_all_others_does_no_harm(far):
    contacts = rings(ELLIPSOID, np.random.default_rng(3), sweeps=6)
    point = contacts.point.copy()
    point[100, 0] += far
    shape = vb.fit_shape(replace(contacts, point=point))
    assert shape.outlier[100]
    assert "too far from all others" in shape.warnings[0]
    plain = vb.fit_shape(contacts[np.arange(len(point)) != 100])
    places = samples(ELLIPSOID, 50)
    np.testing.assert_array_equal(shape.distance(places), plain.distance(places))


@pytest.mark.parametrize("name", ["covariance", "normal_covariance"])
def test_what_is_no_covariance_is_refused(name):
    contacts = rings(ELLIPSOID, np.random.default_rng(3), sweeps=4)
    wrong = getattr(contacts, name).copy()
    wrong[7] = wrong[7] @ np.diag([1.0, -1.0, 1.0])
    with pytest.raises(ValueError, match=rf"{name}\[7\] has the eigenvalue -"):
        vb.fit_shape(replace(contacts, **{name: wrong}))


@pytest.mark.parametrize("sweeps", [4, 12])
def test_a_sweep_inside_out_is_named(sweeps):
    contacts = rings(ELLIPSOID, np.random.default_rng(3), sweeps=sweeps)
    normal = np.where(contacts.sweep[:, None] == 2, -1, 1) * contacts.normal
    warnings = vb.fit_shape(replace(contacts, normal=normal)).warnings
    assert any("sweep 2: 100 % of its normals point against" in line for line in warnings)
    assert not vb.fit_shape(contacts).warnings


PLATE = vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.03, 0.02, 0.0005))


def both_faces(rng: np.random.Generator) -> vb.Contacts:
    """Seven sweeps over either face of a plate of 1 mm."""
    x, y = np.meshgrid(np.linspace(-0.028, 0.028, 30), np.linspace(-0.018, 0.018, 7))
    up = np.repeat([1.0, -1.0], x.size)
    point = np.column_stack([*np.tile([x.ravel(), y.ravel()], 2), 0.0005 * up])
    return vb.Contacts(
        point + POINT * rng.normal(size=point.shape),
        up[:, None] * [0.0, 0.0, 1.0],
        np.tile(POINT**2 * np.eye(3), (len(point), 1, 1)),
        np.tile(NORMAL**2 * np.eye(3), (len(point), 1, 1)),
        sweep=np.arange(len(point)) // 30,
    )


def test_faces_of_a_thin_plate_are_not_inside_out():
    assert not inside_out(gathered(both_faces(np.random.default_rng(0))))


def test_a_thin_plate_does_not_slip_through_the_cells_of_its_mesh():
    mesh = vb.fit_shape(both_faces(np.random.default_rng(0))).mesh()
    inner = np.all(np.abs(mesh.vertices[:, :2]) < [0.028, 0.018], axis=1)
    area = vertex_areas(mesh.vertices, mesh.faces)[inner].sum()
    assert area == pytest.approx(2 * 0.056 * 0.036, rel=0.02)
    np.testing.assert_allclose(PLATE.distances(mesh.vertices[inner]), 0, atol=5 * POINT)


def test_a_void_in_a_solid_is_not_seen():
    outer, inner = trimesh.creation.icosphere(3, 0.02), trimesh.creation.icosphere(3, 0.01)
    vertices = np.concatenate([outer.vertices, inner.vertices])
    faces = np.concatenate([outer.faces, inner.faces + len(outer.vertices)])
    seen = _touched(vertices, faces, 1.001 * outer.vertices[::50])
    assert seen.tolist() == [True] * len(outer.vertices) + [False] * len(inner.vertices)


def test_mesh_of_a_sharp_block_is_closed():
    turn = Rotation.random(rng=np.random.default_rng(0))
    block = vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.020, 0.014, 0.006))
    contacts = rings(block.placed(turn, np.zeros(3)), np.random.default_rng(0), sweeps=30)
    assert vb.fit_shape(contacts).mesh(extrapolate=True).to_trimesh().is_watertight


def test_contacts_in_one_place():
    with pytest.raises(ValueError, match="all lie in one place"):
        vb.fit_shape(vb.Contacts(np.ones((5, 3)), np.tile([0.0, 0, 1], (5, 1))))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"length_scale": -1.0}, "length_scale = -1"),
        ({"length_scale": 1e-9}, "length_scale = 1e-09, with contacts .* unit of length"),
        ({"swept": np.zeros((4, 3))}, r"swept has shape \(4, 3\); allowed is \(k, m, 3\)"),
        ({"swept": [np.zeros((4, 2, 2))]}, r"swept\[0\] has shape \(4, 2, 2\)"),
        ({"swept": np.full((4, 2, 3), np.nan)}, "swept: each rod has points that are not finite"),
    ],
)
def test_wrong_arguments(options, said):
    given = rings(ELLIPSOID, np.random.default_rng(0), sweeps=1)
    with pytest.raises(ValueError, match=said):
        vb.fit_shape(given, **options)


def test_resolution_that_would_take_all_memory(ellipsoid):
    with pytest.raises(ValueError, match="resolution = 1e-05"):
        ellipsoid.mesh(1e-5)


def test_cells_that_the_object_would_slip_through(ellipsoid):
    for lattice in (ellipsoid.mesh, ellipsoid.surface, ellipsoid.occupancy):
        with pytest.raises(ValueError, match=r"resolution = 10; allowed is at most .* extent"):
            lattice(10.0)


@pytest.mark.parametrize(("value", "said"), [(np.nan, "nan"), (0.5, "0.5")])
def test_sweeps_that_are_no_whole_numbers(value, said):
    sweep = np.array([0, 0, value])
    with pytest.raises(ValueError, match=rf"sweep\[2\] = {said}; allowed are whole numbers"):
        vb.Contacts(np.eye(3), np.eye(3), sweep=sweep)


def test_contacts_on_sharp_edges_are_kept():
    """A rod that slides round the edge of a box touches one place, with ever other normals. Through
    contacts as they are, 85 of 198 were outliers, and the surface was 0.47 mm off.
    """
    x, y, z = np.eye(3)
    edges = [(-z, -x, y, 0.012), (z, x, y, 0), (x, z, y, -0.006), (x, y, z, -0.006)]
    edges += [
        (x, y, z, 0.006),
        (-z, -x, -y, 0.012),
        (x, -z, -y, 0.012),
        (-z, -x, y, 0),
        (z, x, y, 0.006),
    ]
    half, rng, parts = np.array([0.01103, 0.014, 0.0148]), np.random.default_rng(7), []
    angle = np.linspace(0.02, 1.1, 22)[:, None]
    for first, then, along, place in edges:
        point = half * (first + then) + place * along
        normal = np.cos(angle) * first + np.sin(angle) * then
        parts.append(_felt(point, normal, rng))
    shape = vb.fit_shape(parts)
    assert shape.sites.size.sum() == 198
    touched = np.concatenate([part.point for part in parts])
    assert np.median(np.abs(shape.distance(touched))) < 2 * POINT
    box = vb.surfaces.Box(center=(0, 0, 0), half_extents=half)
    points = box.nearest(touched + 1e-3 * rng.normal(size=touched.shape))
    away = np.abs(shape.distance(points))
    assert away.mean() < 0.2e-3
    assert np.mean(away < 1.96 * shape.deviation(points)) > 0.93
    assert not shape.outlier.any()
    assert not any("contradicts" in line for line in shape.warnings)


def test_walls_that_face_one_another_are_told_apart():
    """Two plates of 12 mm, 3 mm apart, touched on all faces but the narrow ones."""
    rng, parts = np.random.default_rng(0), []
    for middle in (-0.0075, 0.0075):
        for side in (-1, 1):
            for y in np.linspace(-0.015, 0.015, 8):
                z = np.linspace(-0.010, 0.010, 30)
                point = np.column_stack([np.full((30, 2), (middle + side * 0.006, y)), z])
                parts.append(_felt(point, np.tile([side, 0.0, 0.0], (30, 1)), rng))
    shape = vb.fit_shape(parts)
    inner = np.array(
        [[side * 0.0015, y, 0.003] for side in (-1, 1) for y in (-0.011, 0.001, 0.009)]
    )
    assert np.abs(shape.distance(inner)).max() < 0.5e-3
    assert shape.distance((0, 0, 0)) == pytest.approx(0.0015, abs=0.5e-3)


def _felt(point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> vb.Contacts:
    """Contacts of a sweep at one place or several, with independent errors."""
    turned = normal + NORMAL * rng.normal(size=normal.shape)
    each = (len(normal), 1, 1)
    return vb.Contacts(
        point + POINT * rng.normal(size=normal.shape),
        turned / np.linalg.norm(turned, axis=1)[:, None],
        np.tile(POINT**2 * np.eye(3), each),
        np.tile(NORMAL**2 * np.eye(3), each),
    )
