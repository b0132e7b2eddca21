"""Surfaces as files and figures, and `vibrissa fit`."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import vibrissa
from plyfile import PlyData
from touched import rings

import vibrissa as vb

BALL = vb.surfaces.Sphere(center=(0, 0, 0), radius=0.02)


@pytest.fixture(scope="module")
def mesh() -> vb.ShapeMesh:
    return vb.fit_shape(rings(BALL, np.random.default_rng(0), sweeps=8)).mesh(0.002)


@pytest.fixture
def contacts(tmp_path: Path) -> list[Path]:
    """Contacts as `write_contacts` writes them: kinds and statuses besides."""
    files = []
    for number in range(3):
        given = rings(BALL, np.random.default_rng(number), sweeps=4)
        rows = np.column_stack([given.point, given.normal])
        upper = given.covariance[:, *np.triu_indices(3)]
        file = tmp_path / f"sweep{number}.csv"
        header = "time,x,y,z,nx,ny,nz,arc_length,kind,status,cxx,cxy,cxz,cyy,cyz,czz"
        lines = [
            ",".join([str(i), *map(repr, row.tolist()), "0.04,2,0", *map(repr, spread.tolist())])
            for i, (row, spread) in enumerate(zip(rows, upper, strict=True))
        ]
        file.write_text("\n".join([header, *lines]))
        files.append(file)
    return files


def test_ply_holds_places_normals_and_deviations(mesh, tmp_path):
    read = PlyData.read(str(vb.io.write_shape(tmp_path / "x.ply", mesh)))
    vertex = read["vertex"]
    places = np.column_stack([vertex[name] for name in "xyz"])
    normals = np.column_stack([vertex[f"n{name}"] for name in "xyz"])
    np.testing.assert_array_equal(places, mesh.vertices)
    np.testing.assert_array_equal(vertex["deviation"], mesh.deviation)
    np.testing.assert_array_equal(np.stack(read["face"]["vertex_indices"]), mesh.faces)
    np.testing.assert_array_equal(normals, mesh.normal)


@pytest.mark.parametrize("suffix", ["stl", "glb"])
def test_other_formats_hold_the_same_triangles(mesh, tmp_path, suffix):
    import trimesh

    file = vb.io.write_shape(tmp_path / f"x.{suffix}", mesh)
    read = trimesh.load(file, force="mesh")
    assert read.area == pytest.approx(mesh.to_trimesh().area, rel=1e-5)
    if suffix == "glb":
        deviation = read.vertex_attributes["_DEVIATION"].ravel()
        np.testing.assert_allclose(deviation, mesh.deviation, rtol=1e-6)


def test_a_mesh_without_triangles(mesh, tmp_path):
    nothing = mesh.part(np.zeros(len(mesh.faces), bool))
    with pytest.raises(vb.io.InputError, match="has no triangle"):
        vb.io.write_shape(tmp_path / "x.ply", nothing)
    with pytest.raises(ValueError, match="has no triangle"):
        vb.plot.shape_figure(nothing)


def test_an_unknown_suffix(mesh, tmp_path):
    with pytest.raises(vb.io.InputError, match=r"suffix '.obj'; allowed are .ply, .stl, .glb"):
        vb.io.write_shape(tmp_path / "x.obj", mesh)


def test_figure_is_in_millimetres_and_of_equal_aspect(mesh):
    with vb.plot.journal():
        axes = vb.plot.shape_figure(mesh)
    assert axes.get_xlabel() == "$x$ [mm]"
    low, high = axes.get_zlim()
    assert high - low == pytest.approx(1e3 * np.ptp(mesh.vertices[:, 2]), rel=0.1)
    sizes = [np.ptp(getattr(axes, f"get_{name}lim")()) for name in "xyz"]
    box = axes._box_aspect  # type: ignore[attr-defined]
    np.testing.assert_allclose(box / box[0], np.array(sizes) / sizes[0], rtol=1e-6)


def test_files_of_contacts_become_a_mesh_and_a_figure(contacts, tmp_path, capsys):
    mesh, figure = tmp_path / "x.ply", tmp_path / "x.png"
    run = vibrissa(capsys, "fit", *contacts, "-o", mesh, "--figure", figure, "--json")
    assert run.status == 0, run.err
    summary = json.loads(run.out)
    assert summary["contacts"] == 3 * 4 * 40
    vertex = PlyData.read(str(mesh))["vertex"]
    places = np.column_stack([vertex[name] for name in "xyz"])
    away = np.abs(np.linalg.norm(places, axis=1) - 0.02)
    assert away.mean() < 0.05e-3
    assert np.mean(away < 1.96 * vertex["deviation"]) > 0.9
    assert figure.stat().st_size > 20_000


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "column"),
        ("x,y,z\n1,2,3\n", "nx"),
        (
            "x,y,z,nx,ny,nz,arc_length,kind,status\n0,0,0,0,0,1,0.04,1,0\n",
            "1 of 1 rows hold a contact with status OK; allowed are at least 3",
        ),
    ],
)
def test_files_that_hold_no_surface(text, said, tmp_path, capsys):
    file = tmp_path / "contacts.csv"
    file.write_text(text)
    run = vibrissa(capsys, "fit", file, "-o", tmp_path / "x.ply")
    assert run.status == 2
    assert "contacts.csv" in run.err
    assert said in run.err
    assert "Traceback" not in run.err
