"""Every example runs, and its numbers are right."""

import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb

EXAMPLES = Path(__file__).parents[2] / "examples"
SPHERE = np.array([0.0, 0.0, 0.0575])


def _load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_is_tested() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {
        "first_steps",
        "make_bench",
        "make_mug",
        "make_recording",
        "own_surface",
    }


def test_first_steps() -> None:
    assert _load("first_steps").main() < 1e-14


def test_own_surface() -> None:
    counts = _load("own_surface").main()
    assert counts["wavy"] > 400
    assert counts["blob"] > 300


@pytest.mark.slow
def test_mug_is_the_one_that_the_script_makes(tmp_path: Path) -> None:
    script = _load("make_mug")
    made = script.main(tmp_path / "mug.ply")
    assert made.is_watertight
    # One handle.
    assert made.euler_number == 0
    assert np.max(np.abs(script.mug().levels(made.vertices))) < 1e-12
    # Wall, bottom and handle by Pappus; what the roundings take and the fillets add is little.
    wall, depth = script.RADIUS - script.WALL, script.HEIGHT - script.BOTTOM
    handle = np.pi**2 * script.HANDLE * script.THICKNESS**2
    assert made.volume == pytest.approx(
        np.pi * (script.RADIUS**2 * script.HEIGHT - wall**2 * depth) + handle, rel=0.02
    )
    assert np.degrees(made.face_angles.min()) > 20
    assert (tmp_path / "mug.ply").stat().st_size == script.FILE.stat().st_size < 1e6
    shipped = vb.surfaces.Mesh.load(script.FILE, 1e-3)
    assert not shipped.repairs
    np.testing.assert_array_equal(shipped.faces, made.faces)
    np.testing.assert_allclose(1e3 * shipped.vertices, made.vertices, atol=1e-5)


def test_recording_is_the_one_that_the_script_makes(tmp_path: Path) -> None:
    path = tmp_path / "trail.csv"
    scan = _load("make_recording").main(path)
    shipped = np.loadtxt(EXAMPLES / "recordings/sphere_60mm/trail.csv", delimiter=",", skiprows=1)
    made = np.loadtxt(path, delimiter=",", skiprows=1)
    # Rounding to the sensor's resolution may differ by a step where a platform's last digit does.
    assert np.mean(np.abs(made - shipped) > 1e-12) < 1e-3
    assert np.linalg.norm(scan.point[scan.in_contact] - SPHERE, axis=-1) == pytest.approx(
        0.03, abs=1e-12
    )


def test_bench_is_what_the_script_makes_of_the_engines_logs(
    sphere_60mm: Path, tmp_path: Path
) -> None:
    script = _load("make_bench")
    script.main(sphere_60mm.parent, tmp_path)
    made = sorted(tmp_path.iterdir())
    assert len(made) == 2 * len(script.SOURCES)
    for path in made:
        assert path.read_bytes() == (script.FOLDER / path.name).read_bytes(), path.name


def test_shipped_recording_gives_the_sphere() -> None:
    setup = vb.load_setup(EXAMPLES / "recordings/sphere_60mm/setup.toml")
    found = vb.reconstruct(
        setup.rod, vb.read_recording(EXAMPLES / "recordings/sphere_60mm/trail.csv", setup)
    )
    assert found.covariance is not None
    rows = found.in_contact & (found.status == vb.Status.OK)
    radius = np.linalg.norm(found.point[rows] - SPHERE, axis=-1)
    outward = (found.point[rows] - SPHERE) / radius[:, None]
    deviation = np.sqrt(np.einsum("ni,nij,nj->n", outward, found.covariance[rows], outward))
    assert np.median(np.abs(radius - 0.03)) < 2e-4
    assert 0.9 < np.mean(np.abs(radius - 0.03) < 1.96 * deviation) < 0.99
    tilt = np.degrees(np.arccos(np.sum(outward * found.normal[rows], axis=-1)))
    assert np.median(tilt) < 2.0


@cache
def swept(name: str) -> tuple[vb.Case, vb.Scan]:
    """A case and its scan; kept, since a mesh takes its time."""
    case = vb.load_case(EXAMPLES / f"cases/{name}.toml")
    return case, vb.scan(
        case.rod, case.surface, case.trail, friction=case.friction, finite_radius=case.finite_radius
    )


CASES = sorted(path.stem for path in (EXAMPLES / "cases").glob("*.toml"))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "mug")) for name in CASES]
)
def test_cases(name: str) -> None:
    case, scan = swept(name)
    contact = scan.in_contact
    assert contact.any()
    assert scan.solved.all()
    # Near its tip the whisker is ten million times softer than at its base.
    assert np.max(scan.residual[contact]) < (1e-12 if case.rod.plain else 2e-9)
    assert np.max(scan.depth[contact]) < 1e-7 * case.rod.length
    assert np.max(np.abs(case.surface.levels(scan.point[contact]))) < 1e-12


def test_the_whisker_is_that_of_the_catalogue() -> None:
    case, scan = swept("rat_whisker")
    listed = vb.rods.rat_whisker(row="C", column=1)
    for x in (0.0, 0.5, 1.0):
        assert float(case.rod.bending_at(x)) == pytest.approx(float(listed.bending_at(x)), rel=1e-3)
    assert case.rod.bending_stiffness == pytest.approx(listed.bending_stiffness, rel=1e-3)
    assert {*np.unique(scan.kind)} == {*vb.ContactKind}


def test_the_wire_hangs_in_the_wind() -> None:
    """Drag of a cylinder at Re = 67 has the coefficient 1.5 ± 10 % (C. Wieselsberger, NACA TN 84)."""
    _, scan = swept("wire_in_wind")
    drag, weight = np.split(-scan.reactions.force[0, 0], [2])
    # Drag across the leaning wire also lifts it.
    own = 7850 * np.pi * 0.1e-3**2 * 0.1 * 9.81
    assert 0.9 * own < -weight[0] < own
    np.testing.assert_allclose(drag / np.linalg.norm(drag), [0.6, 0.8], atol=0.02)
    still = 1.204 / 2 * 5**2 * 2e-4 * 0.1
    assert np.linalg.norm(drag) / still == pytest.approx(1.5, rel=0.1)
    tip = scan.elastic_line((0, 0), 2)[1] - scan.trail.position[0, 0]
    assert tip[0] > 1e-3
    assert tip[1] > 1e-3


def test_the_follicle_yields() -> None:
    _, scan = swept("follicle")
    rows = scan.in_contact
    moved = scan.elastic_lines(rows, 2)[:, 0] - scan.trail.position[rows]
    turn = Rotation.from_quat(scan.trail.orientation[rows])
    expected = turn.inv().apply(-scan.reactions.force[rows]) / [0.05, 0.05, 0.2]
    np.testing.assert_allclose(turn.inv().apply(moved), expected, rtol=1e-9)
    assert np.linalg.norm(moved, axis=1).max() > 0.1e-3


def test_the_case_with_friction_is_that_of_the_recording() -> None:
    """Force off the normal by atan μ wherever the wire slides."""
    case, scan = swept("sphere_friction")
    assert (case.friction, case.finite_radius) == (0.25, False)
    rows = scan.motion == vb.Motion.SLIP
    outward = (scan.point[rows] - SPHERE) / 0.03
    force = -scan.reactions.force[rows]
    cosine = np.sum(outward * force, axis=1) / np.linalg.norm(force, axis=1)
    assert np.count_nonzero(rows) > 200
    np.testing.assert_allclose(
        np.degrees(np.arccos(cosine)), np.degrees(np.arctan(0.25)), atol=1e-6
    )


@pytest.mark.slow
def test_the_case_of_the_mug_touches_where_it_is_hollow() -> None:
    """Wall, then the inside of the handle, which is a saddle, and the rim out of the cavity:
    against the solid that the mesh samples.
    """
    _, scan = swept("mug")
    np.testing.assert_array_equal(scan.status, vb.Status.OK)
    solid = _load("make_mug").mug()
    # The case's placement, undone: (x, y, z) of the mug is (-x, -z, -y) of the world.
    mug = (-1e3 * (scan.point - [0, 0.044, 0.057]))[..., [0, 2, 1]]
    wall, handle, rim = (mug[lane][scan.in_contact[lane]] for lane in range(3))
    assert np.max(np.abs(solid.distances(np.concatenate([wall, handle, rim])))) < 0.03
    np.testing.assert_allclose(wall[:, 2], 22, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(handle[0] - [22, 0, 22]), 13 - 3.5, atol=0.01)
    assert solid.normal(handle[0])[0] < -0.99
    # The rim's inner half, until the rod snaps round it, and holds on to the outside with its tip.
    assert rim[0, 2] > 44 - 2.5
    assert -(22 - 2.5) < rim[0, 0] < -(22 - 5)
    assert rim[-1, 0] == pytest.approx(-22, abs=0.01)
    assert rim[-1, 2] < 44 - 5


def test_the_case_of_the_box_touches_its_edges() -> None:
    case, scan = swept("box_wire")
    assert case.finite_radius
    rows = scan.in_contact
    # On an edge the normal is that of neither face.
    assert np.count_nonzero(np.sum(np.abs(scan.normal[rows]) > 1e-3, axis=1) == 2) > 20
    assert scan.offset == 0.25e-3
