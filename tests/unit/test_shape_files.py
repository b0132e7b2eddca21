"""Surfaces as files and figures, and `vibrissa fit`."""

import json
from base64 import b64decode
from pathlib import Path
from xml.etree import ElementTree

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


@pytest.fixture(scope="module")
def comparison() -> vb.Comparison:
    """With a model that is larger above and smaller below."""
    shape = vb.fit_shape(rings(BALL, np.random.default_rng(0), sweeps=8))
    return vb.compare(
        shape, vb.surfaces.Sphere(center=(0, 0, 0.5e-3), radius=0.02), resolution=0.002
    )


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


def test_ply_of_a_comparison_is_coloured(comparison, tmp_path):
    read = PlyData.read(str(vb.io.write_shape(tmp_path / "x.ply", comparison)))
    vertex = read["vertex"]
    for name in ("distance", "deviation", "p_value", "significant"):
        np.testing.assert_array_equal(vertex[name], getattr(comparison, name))
    assert vertex["red"].dtype == np.uint8
    above = vertex["z"] > 0.015
    # The model reaches higher: too little material above, too much below.
    assert (vertex["distance"][above] < 0).all()
    assert (vertex["blue"][above].astype(int) > vertex["red"][above]).all()
    below = vertex["z"] < -0.015
    assert (vertex["red"][below].astype(int) > vertex["blue"][below]).all()


def test_gltf_of_a_comparison_is_coloured(comparison, tmp_path):
    import trimesh

    read = trimesh.load(vb.io.write_shape(tmp_path / "x.glb", comparison), force="mesh")
    np.testing.assert_array_equal(read.visual.vertex_colors[:, :3], comparison.colours())
    found = read.vertex_attributes["_DISTANCE"].ravel()
    np.testing.assert_allclose(found, comparison.distance, rtol=1e-6)
    solid = trimesh.load(vb.io.write_shape(tmp_path / "x.stl", comparison))
    assert len(solid.faces) == len(comparison.mesh.faces)


def test_vtp_holds_triangles_and_point_data(comparison, mesh, tmp_path):
    """As VTK's file formats are described: each array in base64, its bytes in front."""
    for given, fields in (
        (comparison, ("distance", "deviation", "p_value", "significant")),
        (mesh, ("deviation", "seen")),
    ):
        own = given.mesh if isinstance(given, vb.Comparison) else given
        root = ElementTree.parse(vb.io.write_shape(tmp_path / "x.vtp", given)).getroot()
        piece = root.find("PolyData/Piece")
        assert piece is not None
        assert piece.attrib["NumberOfPoints"] == str(len(own.vertices))
        assert piece.attrib["NumberOfPolys"] == str(len(own.faces))
        assert piece.attrib["NumberOfVerts"] == "0"
        read = {
            f"{place}/{array.attrib['Name']}": np.frombuffer(
                b64decode(array.text or "")[8:],
                {"Float64": "<f8", "Int64": "<i8", "UInt8": "u1"}[array.attrib["type"]],
            )
            for place in ("Points", "Polys", "PointData")
            for array in piece.iterfind(f"{place}/DataArray")
        }
        np.testing.assert_array_equal(read["Points/Points"], own.vertices.ravel())
        np.testing.assert_array_equal(read["Polys/connectivity"], own.faces.ravel())
        np.testing.assert_array_equal(np.diff(read["Polys/offsets"], prepend=0), 3)
        np.testing.assert_array_equal(read["PointData/normal"], own.normal.ravel())
        for name in fields:
            np.testing.assert_array_equal(read[f"PointData/{name}"], getattr(given, name))


def test_figure_of_a_comparison_is_symmetric_about_zero(comparison):
    with vb.plot.journal():
        axes = vb.plot.comparison_figure(comparison)
        assert axes.get_xlabel() == "$x$ [mm]"
        bar = axes.figure.axes[-1]
        low, high = bar.get_ylim()
        assert low == -high
        assert high == pytest.approx(0.5, rel=0.15)
        assert bar.get_ylabel() == "distance from the model [mm]"
        nothing = vb.compare(vb.fit_shape(rings(BALL, np.random.default_rng(0), sweeps=3)), BALL)
        drawn = vb.plot.comparison_figure(nothing, limit=1e-3)
    colours = drawn.collections[0].get_facecolor()
    assert not nothing.significant.any()
    np.testing.assert_allclose(colours[:, :3], colours[:, :1].repeat(3, axis=1))


def test_a_mesh_without_triangles(mesh, tmp_path):
    nothing = mesh.part(np.zeros(len(mesh.faces), bool))
    with pytest.raises(vb.io.InputError, match="has no triangle"):
        vb.io.write_shape(tmp_path / "x.ply", nothing)
    with pytest.raises(ValueError, match="has no triangle"):
        vb.plot.shape_figure(nothing)


def test_an_unknown_suffix(mesh, tmp_path):
    with pytest.raises(
        vb.io.InputError, match=r"suffix '.obj'; allowed are .ply, .vtp, .stl, .glb"
    ):
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
            "1 of 1 rows hold a contact with status OK and a known normal; allowed are at least 3",
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


def test_a_shape_is_read_back_from_its_ply(tmp_path):
    contacts = rings(BALL, np.random.default_rng(0), sweeps=6)
    swept = np.stack([[[0.05, 0, z], [0.03, 0, z]] for z in np.linspace(-0.02, 0.02, 5)])
    shape = vb.fit_shape(contacts, swept=swept, length_scale=0.03)
    path = vb.io.write_shape(tmp_path / "ball.ply", shape.mesh(0.004), fitted=shape)
    again = vb.io.read_shape(path)
    places = 0.02 * np.random.default_rng(1).normal(size=(50, 3))
    assert np.array_equal(again.distance(places), shape.distance(places))
    assert np.array_equal(again.deviation(places), shape.deviation(places))
    assert again.length_scale == 0.03
    assert again.swept.shape == (10, 3)


def test_a_mesh_without_contacts_is_no_shape(mesh, tmp_path):
    path = vb.io.write_shape(tmp_path / "bare.ply", mesh)
    with pytest.raises(vb.io.InputError, match=r"bare.ply: a mesh without the contacts.*allowed"):
        vb.io.read_shape(path)


CASE = """
[rod]
kind = "cylinder"
length = 0.05
radius = 0.25e-3
youngs_modulus = 206e9

[object]
kind = "sphere"
center = [0, 0, 0]
radius = 0.02

[[trail]]
kind = "raster"
start = [0.04, -0.004, -0.05]
stop = [-0.05, -0.004, -0.05]
count = 60
step = [0, 0.008, 0]
trails = 2
"""


def test_the_next_sweep_of_a_case(contacts, tmp_path, capsys):
    case, shape = tmp_path / "case.toml", tmp_path / "shape.ply"
    case.write_text(CASE)
    vibrissa(capsys, "fit", *contacts, "-o", shape)
    path = tmp_path / "next.csv"
    ran = vibrissa(capsys, "next", shape, case, "--around", "-o", path, "--json")
    assert ran.status == 0
    said = json.loads(ran.out)
    assert said["candidates"] == 120
    best = said["best"][0]
    assert best["status"] == "OK"
    assert 0 < best["gain"] <= said["unknown"]
    trail = vb.Trail.from_csv(path)
    assert np.allclose(trail.position[0], best["start"])
    assert np.allclose(trail.position[-1], best["stop"])
    given = vb.load_case(case).trail
    # A rotation of the case's own: its length stays.
    ends = given.position[0, [0, -1]], trail.position[[0, -1]]
    before, after = (np.linalg.norm(last - first) for first, last in ends)
    assert after == pytest.approx(before)
    text = vibrissa(capsys, "next", shape, case, "--tolerance", "1e-3").out
    assert "2 sweeps, 0 of them refused" in text
    assert "% not known to 0.001 m" in text
    assert "touches nothing" not in text
    case.write_text(CASE.replace("-0.05]", "-5.05]"))
    text = vibrissa(capsys, "next", shape, case).out
    assert text.count("touches nothing") == 2
