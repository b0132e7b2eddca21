"""Setups and cases: what a good file builds, and the one line that says what is wrong with a bad
one.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bench_files import CASE, SETUP
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.io import InputError
from vibrissa.sensor import LowPass, Mount


def written(folder: Path, text: str | bytes) -> Path:
    file = folder / "file.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


def refusal(load: Callable[[Path], object], file: Path) -> str:
    with pytest.raises(InputError) as caught:
        load(file)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(file))
    return message.removeprefix(f"{file}").lstrip(": ")


def test_a_setup_builds_rod_sensor_and_object(tmp_path: Path) -> None:
    setup = vb.load_setup(written(tmp_path, SETUP))
    assert setup.rod == vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
    np.testing.assert_array_equal(setup.sensor.clamp_position, [0.001, 0.002, 0.025])
    figures = (
        "wrench",
        "wrench_frame",
        "wrench_point",
        "tare_seconds",
        "force_noise",
        "torque_noise",
    )
    expected = [
        "on_sensor",
        "sensor",
        (0.0, 0.0, 0.001),
        0.85,
        2e-3,
        4e-5,
        1.5625e-3,
        7.8125e-6,
        1e-5,
    ]
    steps = ("force_resolution", "torque_resolution", "position_noise")
    assert [getattr(setup.sensor, name) for name in figures + steps] == expected
    assert setup.surface is not None
    assert float(setup.surface.levels([0.0, 0.0, 0.0])) == pytest.approx(0.0275, abs=1e-15)


def test_object_and_noise_may_be_left_out(tmp_path: Path) -> None:
    lines = SETUP[: SETUP.index("[object]")].splitlines()
    kept = [line for line in lines if "noise" not in line and "resolution" not in line]
    setup = vb.load_setup(written(tmp_path, "\n".join(kept)))
    assert (setup.surface, setup.sensor.force_noise, setup.sensor.force_resolution) == (
        None,
        None,
        0.0,
    )


def test_a_case_builds_rod_object_and_trails(tmp_path: Path) -> None:
    case = vb.load_case(written(tmp_path, CASE))
    assert (case.rod.length, case.rod.bending_stiffness, case.rod.units) == (0.05, 6.3e-4, "SI")
    assert case.trail.shape == (2, 9)
    np.testing.assert_allclose(
        case.trail.position[0, [0, -1]], [(0.04, 0.005, 0), (-0.04, 0.005, 0)], atol=1e-17
    )
    np.testing.assert_allclose(
        case.trail.axis[1], [Rotation.from_quat([0, 0.6, 0, 0.8]).apply([0, 0, 1])] * 9
    )
    # On the surface: an end of the second semi-axis, turned and moved as the table says.
    end = Rotation.from_quat([0, 0, 0.6, 0.8]).apply([0, 0.02, 0.0575]) + [0.001, 0, 0]
    assert float(case.surface.levels(end)) == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize(
    ("table", "inside"),
    [
        ('kind = "elliptic_paraboloid"\na = 0.5\nb = 1\nh = 0.4', (0.0, 0.0, 0.5)),
        ('kind = "sphere"\ncenter = [0, 0, 1]\nradius = 0.1', (0.0, 0.05, 1.0)),
        ('kind = "ellipsoid"\ncenter = [0, 0, 1]\nsemi_axes = [0.1, 0.2, 0.3]', (0.0, 0.0, 1.2)),
        ('kind = "elliptic_cylinder"\ncenter = [0, 0, 1]\nsemi_axes = [0.1, 0.2]', (0.0, 9.0, 1.1)),
        ('kind = "plane"\npoint = [0, 0, 1]\nnormal = [0, 0, -1]', (0.0, 0.0, 2.0)),
        ('kind = "box"\ncenter = [0, 0, 1]\nhalf_extents = [0.1, 0.2, 0.3]', (0.09, -0.19, 1.29)),
        (
            'kind = "cylinder"\ncenter = [0, 0, 1]\naxis = [0, 2, 0]\nradius = 0.1\nlength = 0.4',
            (0.09, 0.19, 1.0),
        ),
        (
            'kind = "capsule"\ncenter = [0, 0, 1]\naxis = [0, 2, 0]\nradius = 0.1\nlength = 0.4',
            (0.0, 0.29, 1.0),
        ),
        (
            'kind = "cone"\ncenter = [0, 0, 1]\naxis = [0, 0, 3]\nradius = 0.2\nheight = 0.5',
            (0.0, 0.0, 1.49),
        ),
        (
            'kind = "torus"\ncenter = [0, 0, 1]\naxis = [0, 0, 1]\nmajor_radius = 0.5\nminor_radius = 0.1',
            (0.59, 0.0, 1.0),
        ),
        (
            'kind = "superquadric"\ncenter = [0, 0, 1]\nsemi_axes = [0.1, 0.2, 0.3]\nexponents = [0.1, 0.1]',
            (0.09, 0.18, 1.27),
        ),
        (
            'kind = "offset"\nradius = 0.1\nsurface = { kind = "sphere", center = [0, 0, 1], radius = 0.5 }',
            (0.0, 0.0, 0.41),
        ),
        (
            'kind = "union"\ntranslation = [0, 0, 1]\nparts = [{ kind = "sphere", center = [1, 0, 0], radius = 0.1 }, '
            '{ kind = "box", center = [0, 0, 0], half_extents = [0.3, 0.1, 0.1], rotation = [0, 0, 1, 1] }]',
            (0.0, 0.29, 1.0),
        ),
    ],
)
def test_every_kind_of_object_can_be_written_down(
    tmp_path: Path, table: str, inside: tuple[float, ...]
) -> None:
    case = vb.load_case(written(tmp_path, with_object(table)))
    assert (
        float(case.surface.levels(np.array(inside)))
        < 0
        < float(case.surface.levels([0.0, 0.0, 0.0]))
    )


# An octahedron of 20 mm from corner to corner, in millimetres.
OCTAHEDRON = """\
v 10 0 0
v -10 0 0
v 0 10 0
v 0 -10 0
v 0 0 10
v 0 0 -10
f 1 3 5
f 3 2 5
f 2 4 5
f 4 1 5
f 3 1 6
f 2 3 6
f 4 2 6
f 1 4 6
"""
MESH = (
    'kind = "mesh"\nfile = "parts/octahedron.obj"\nscale = 1e-3\ntranslation = [0.0, 0.0, 0.05]\n'
)


def with_object(table: str) -> str:
    start, stop = CASE.index("[object]"), CASE.index("[[trail]]")
    return f"{CASE[:start]}[object]\n{table}\n\n{CASE[stop:]}"


def octahedron(folder: Path, text: str = OCTAHEDRON) -> Path:
    (folder / "parts").mkdir(parents=True, exist_ok=True)
    (folder / "parts" / "octahedron.obj").write_text(text)
    return folder


@pytest.mark.parametrize(
    "table",
    [
        MESH,
        MESH.replace(
            "translation",
            "rotation = [0.0, 0.0, 1.0, 1.0]\ncrease_angle = 0.5\nreach = 1e-3\ntranslation",
        ),
        'kind = "union"\ntranslation = [0.0, 0.0, 0.05]\nparts = [{ kind = "mesh", file = "parts/octahedron.obj", scale = 1e-3 }, '
        '{ kind = "sphere", center = [0.03, 0, 0], radius = 0.005 }]\n',
    ],
    ids=["alone", "turned", "in a union"],
)
def test_a_mesh_comes_from_a_file_beside_the_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: str
) -> None:
    file = written(octahedron(tmp_path / "cases"), with_object(table))
    monkeypatch.chdir(tmp_path)
    for path in (file, file.relative_to(tmp_path)):
        surface = vb.load_case(path).surface
        # The middle of a face is 10 mm / √3 from the centre; on the flat of it, half the way to an
        # edge, the level is the distance.
        face = np.array([1.0, 1.0, 1.0]) / 3 * 0.01
        np.testing.assert_allclose(surface.levels(face + [0, 0, 0.05]), 0, atol=1e-12)
        np.testing.assert_allclose(
            surface.levels(1.1 * face + [0, 0, 0.05]), 0.1 * 0.01 / np.sqrt(3), atol=1e-12
        )


def test_a_setup_may_name_a_mesh(tmp_path: Path) -> None:
    setup = vb.load_setup(written(octahedron(tmp_path), SETUP.replace(OBJECT, MESH)))
    assert setup.surface is not None
    assert (
        float(setup.surface.levels([0.0, 0.0, 0.05]))
        < 0
        < float(setup.surface.levels([0.0, 0.0, 0.0]))
    )


def test_a_file_with_its_own_unit_needs_no_scale(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosahedron().export(tmp_path / "ball.glb")
    case = vb.load_case(
        written(
            tmp_path, with_object('kind = "mesh"\nfile = "ball.glb"\ntranslation = [0.0, 0.0, 3.0]')
        )
    )
    assert (
        float(case.surface.levels([0.0, 0.0, 3.0]))
        < 0
        < float(case.surface.levels([0.0, 0.0, 0.0]))
    )


MESH_DAMAGE = {
    "no file": (
        'file = "parts/octahedron.obj"\n',
        "",
        ["object.file: missing", "the path of a mesh"],
    ),
    "number for a file": ('"parts/octahedron.obj"', "3", ["object.file = 3", "the path of a mesh"]),
    "missing file": (
        "parts/octahedron.obj",
        "none.obj",
        ["file = 'none.obj'", "cannot be read", "allowed is a file"],
    ),
    "suffix": (
        "octahedron.obj",
        "octahedron.step",
        ["file = 'parts/octahedron.step'", "suffix '.step'", "allowed are .stl, .obj"],
    ),
    "no scale": (
        "scale = 1e-3\n",
        "",
        [
            "file = 'parts/octahedron.obj'",
            "scale is missing",
            "OBJ has no unit",
            "1e-3 for millimetres",
        ],
    ),
    "scale of zero": ("scale = 1e-3", "scale = 0", ["object.scale = 0", "a number greater than 0"]),
    "angle in degrees": (
        "scale = 1e-3",
        "scale = 1e-3\ncrease_angle = 40",
        ["object.crease_angle = 40", "greater than 0 and at most π"],
    ),
    "negative reach": (
        "scale = 1e-3",
        "scale = 1e-3\nreach = -1e-3",
        ["object.reach = -0.001", "a number of at least 0"],
    ),
    "reach beyond all": (
        "scale = 1e-3",
        "scale = 1e-3\nreach = 1.0",
        ["reach = 1.0", "diagonal, 0.034641"],
    ),
    "unknown key": (
        "scale = 1e-3",
        "unit = 1e-3",
        ["object.unit: unknown key", "file, scale, crease_angle, reach"],
    ),
}


@pytest.mark.parametrize("what", MESH_DAMAGE)
def test_damage_to_the_table_of_a_mesh_is_named(tmp_path: Path, what: str) -> None:
    good, bad, words = MESH_DAMAGE[what]
    assert good in MESH
    message = refusal(
        vb.load_case, written(octahedron(tmp_path), with_object(MESH.replace(good, bad, 1)))
    )
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (OCTAHEDRON + "v 0 0 30\nf 1 3 7\n", ["1 edge", "more than two triangles", "allowed"]),
        (OCTAHEDRON[: OCTAHEDRON.index("f 1")], ["allowed"]),
        ("", ["allowed"]),
        (OCTAHEDRON.replace("v 10 0 0", "v nan 0 0"), ["= nan", "finite", "allowed"]),
    ],
    ids=["a third triangle", "no triangles", "empty", "no number"],
)
def test_damage_to_a_mesh_names_both_files(tmp_path: Path, text: str, words: list[str]) -> None:
    message = refusal(vb.load_case, written(octahedron(tmp_path, text), with_object(MESH)))
    assert [word for word in ["file = 'parts/octahedron.obj'", *words] if word not in message] == []


@pytest.mark.parametrize("missing", ["trimesh", "igl"])
def test_a_missing_library_for_meshes_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    message = refusal(vb.load_case, written(octahedron(tmp_path), with_object(MESH)))
    assert (
        message
        == f"object.file = 'parts/octahedron.obj': {missing} is not installed; meshes need it: python3 -m pip install 'vibrissa[mesh]'"
    )


def test_model_units_and_rasters(tmp_path: Path) -> None:
    text = """
    [rod]
    kind = "unit"
    [object]
    kind = "plane"
    point = [0, 0, 1]
    normal = [0, 0, -1]
    [[trail]]
    kind = "raster"
    start = [1, 0, 0]
    stop = [0, 0, 0]
    count = 3
    step = [0, 0.5, 0]
    trails = 4
    axis = [0, 0, 2]
    """
    case = vb.load_case(written(tmp_path, text))
    assert case.rod == vb.Rod.unit()
    np.testing.assert_allclose(case.trail.position[3, 2], [0, 1.5, 0])


def test_friction_and_a_finite_radius_are_taken_from_the_case(tmp_path: Path) -> None:
    contact = "[contact]\nfriction = 0.25\nfinite_radius = true\n\n[[trail]]"
    thick = CASE.replace(
        "bending_stiffness = 6.3e-4", "bending_stiffness = 6.3e-4\nradius = 0.25e-3"
    )
    case, without = (
        vb.load_case(written(tmp_path, text))
        for text in (thick.replace("[[trail]]", contact, 1), CASE)
    )
    assert (case.friction, case.finite_radius) == (0.25, True)
    assert (without.friction, without.finite_radius) == (0.0, False)
    message = refusal(vb.load_case, written(tmp_path, CASE.replace("[[trail]]", contact, 1)))
    assert (
        message
        == "contact.finite_radius = true: rod.radius is missing; allowed is a number greater than 0"
    )


TRAILS = {
    "arc": (
        "center = [0, 0, 0]\naxis = [0, 0, 2]\nstart = [0.02, 0, 0]\nangle = 1.5\ncount = 9\nturning = true\nrod_axis = [1, 0, 1]",
        vb.Trail.arc(
            center=(0, 0, 0),
            axis=(0, 0, 1),
            start=(0.02, 0, 0),
            angle=1.5,
            count=9,
            turning=True,
            rod_axis=(1, 0, 1),
        ),
    ),
    "whisk": (
        "pivot = [0, 0, -0.01]\naxis = [0, 1, 0]\nposition = [0, 0, 0]\nstart_angle = -1\nstop_angle = 0.5\ncount = 9\norientation = [0, 0, 0.6, 0.8]",
        vb.Trail.whisk(
            pivot=(0, 0, -0.01),
            axis=(0, 1, 0),
            position=(0, 0, 0),
            start_angle=-1,
            stop_angle=0.5,
            count=9,
            orientation=(0, 0, 0.6, 0.8),
        ),
    ),
    "spline": (
        "points = [[0.04, 0, 0], [0, 0.01, 0], [-0.04, 0, 0]]\ncount = 9\norientations = [[0, 0, 0, 1], [0, 0.1, 0, 1], [0, 0, 0, 1]]",
        vb.Trail.spline(
            [(0.04, 0, 0), (0, 0.01, 0), (-0.04, 0, 0)],
            9,
            orientations=np.array([(0, 0, 0, 1), (0, 0.1, 0, 1), (0, 0, 0, 1)]),
        ),
    ),
    "spline that keeps its orientation": (
        "points = [[0.04, 0, 0], [0, 0.01, 0], [-0.04, 0, 0]]\ncount = 9\norientations = [[0, 0.6, 0, 0.8]]",
        vb.Trail.spline(
            [(0.04, 0, 0), (0, 0.01, 0), (-0.04, 0, 0)], 9, orientations=(0, 0.6, 0, 0.8)
        ),
    ),
}


@pytest.mark.parametrize("kind", TRAILS)
def test_every_motion_can_be_written_down(tmp_path: Path, kind: str) -> None:
    keys, expected = TRAILS[kind]
    case = vb.load_case(
        written(
            tmp_path,
            f'{CASE[: CASE.index("[[trail]]")]}[[trail]]\nkind = "{kind.partition(" ")[0]}"\n{keys}\n',
        )
    )
    np.testing.assert_array_equal(case.trail.position, expected.position)
    np.testing.assert_array_equal(case.trail.orientation, expected.orientation)


POSES = "x,y,z,qx,qy,qz,qw\n0.04,0,0,0,0,0,1\n0.03,0,0,0,0.1,0,1\n"
FROM_FILE = CASE[: CASE.index("[[trail]]")] + '[[trail]]\nkind = "csv"\npath = "sub/poses.csv"\n'


def test_poses_come_from_a_file_beside_the_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cases" / "sub").mkdir(parents=True)
    (tmp_path / "cases" / "sub" / "poses.csv").write_text(POSES)
    file = written(tmp_path / "cases", FROM_FILE)
    monkeypatch.chdir(tmp_path)
    for path in (file, file.relative_to(tmp_path)):
        np.testing.assert_array_equal(
            vb.load_case(path).trail.position, [(0.04, 0, 0), (0.03, 0, 0)]
        )


def test_damage_to_the_file_of_poses_names_both_files(tmp_path: Path) -> None:
    file = written(tmp_path, FROM_FILE)
    assert "sub/poses.csv: cannot be read" in refusal(vb.load_case, file)
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "poses.csv").write_text(POSES.replace("0.03", "nan"))
    assert "sub/poses.csv, line 3: x = nan" in refusal(vb.load_case, file)


def test_the_recordings_own_setup_is_read(sphere_60mm: Path) -> None:
    setup = vb.load_setup(sphere_60mm / "setup.toml")
    assert setup.rod.bending_stiffness == pytest.approx(206e9 * np.pi * 0.25e-3**4 / 4, rel=1e-14)
    assert setup.sensor.wrench == "on_sensor"


OBJECT = SETUP[SETUP.index("[object]\n") + len("[object]\n") :]
BALL = 'kind = "sphere"\nradius = 0.03\ncenter'
SETUP_DAMAGE = {
    "missing key": ("length = 0.05\n", "", ["rod.length: missing", "a number greater than 0"]),
    "unknown key": (
        "length = 0.05",
        "length = 0.05\nlenght = 1",
        ["rod.lenght: unknown key", "allowed are", "length"],
    ),
    "negative length": (
        "length = 0.05",
        "length = -0.05",
        ["rod.length = -0.05", "a number greater than 0"],
    ),
    "zero radius": (
        "radius = 0.25e-3",
        "radius = 0.0",
        ["rod.radius = 0.0", "a number greater than 0"],
    ),
    "no number": (
        "length = 0.05",
        "length = nan",
        ["rod.length = nan", "allowed is a number greater than 0"],
    ),
    "words": (
        "length = 0.05",
        'length = "long"',
        ["rod.length = 'long'", "allowed is a number greater than 0"],
    ),
    "number in quotes": (
        "length = 0.05",
        'length = "0.05"',
        ["rod.length = '0.05'", "a number greater than 0"],
    ),
    "yes for a number": (
        "length = 0.05",
        "length = true",
        ["rod.length = True", "a number greater than 0"],
    ),
    "list for a number": (
        "length = 0.05",
        "length = [1]",
        ["rod.length = [1]", "a number greater than 0"],
    ),
    "kind of rod": (
        '"cylinder"',
        '"cone"',
        ["rod", "'cone'", "allowed is cylinder, tapered, table, uniform or unit"],
    ),
    "no kind": (
        'kind = "cylinder"\n',
        "",
        ["rod.kind: missing", "cylinder, tapered, table, uniform or unit"],
    ),
    "no sign": (
        'wrench = "on_sensor"\n',
        "",
        ["sensor.wrench: missing", "'on_sensor'", "'on_rod'"],
    ),
    "other sign": (
        '"on_sensor"',
        '"by_sensor"',
        ["sensor.wrench = 'by_sensor'", "'on_sensor'", "'on_rod'"],
    ),
    "other frame": (
        'frame = "sensor"',
        'frame = "clamp"',
        ["sensor.wrench_frame = 'clamp'", "'sensor' or 'world'"],
    ),
    "zero quaternion": (
        "clamp_orientation = [0.0, 0.0, 0.0, 1.0]",
        "clamp_orientation = [0.0, 0.0, 0.0, 0.0]",
        ["clamp_orientation", "zero norm", "of non-zero norm"],
    ),
    "short vector": (
        "[0.001, 0.002, 0.025]",
        "[0.001, 0.002]",
        ["sensor.clamp_position", "allowed is"],
    ),
    "long vector": (
        "[0.001, 0.002, 0.025]",
        "[0, 0, 0, 0]",
        ["sensor.clamp_position", "three finite numbers"],
    ),
    "infinite entry": (
        "[0.001, 0.002, 0.025]",
        "[0, inf, 0]",
        ["sensor.clamp_position[1] = inf", "finite number"],
    ),
    "negative noise": (
        "force_noise = 2.0e-3",
        "force_noise = -1",
        ["sensor.force_noise = -1", "allowed is a number"],
    ),
    "two noises": (
        "force_noise = 2.0e-3",
        "force_noise = [1e-3, 2e-3]",
        ["sensor.force_noise = [0.001, 0.002]", "or three, one for each axis"],
    ),
    "noise as text": (
        "force_noise = 2.0e-3",
        'force_noise = ["1", 2, 3]',
        ["sensor.force_noise = ['1', 2, 3]", "allowed is a number greater than 0"],
    ),
    "no step": (
        "force_resolution = 1.5625e-3",
        "force_resolution = [0, 0, nan]",
        ["sensor.force_resolution = [0, 0, nan]", "a number of at least 0"],
    ),
    "one noise": (
        "torque_noise = 4.0e-5\n",
        "",
        ["force_noise and torque_noise", "allowed are both or none"],
    ),
    "negative tare": (
        "tare_seconds = 0.85",
        "tare_seconds = -0.5",
        ["sensor.tare_seconds = -0.5", "at least 0"],
    ),
    "unknown table": (
        "[object]",
        "[environment]\n[object]",
        ["environment: unknown key", "rod, sensor, object"],
    ),
    "no sensor": (
        SETUP[SETUP.index("[sensor]") : SETUP.index("[object]")],
        "",
        ["sensor: missing"],
    ),
    "ball of no size": (
        "radius = 0.03",
        "radius = 0",
        ["object.radius = 0", "a number greater than 0"],
    ),
    "kind of object": (
        '"sphere"',
        '"cube"',
        ["object", "'cube'", "allowed is elliptic_paraboloid, sphere"],
    ),
    "half extents": (
        BALL,
        'kind = "box"\nhalf_extents = [1, 0, 1]\ncenter',
        ["object.half_extents[1] = 0", "a number greater than 0"],
    ),
    "exponents": (
        BALL,
        'kind = "superquadric"\nsemi_axes = [1, 1, 1]\nexponents = [1, 2.5]\ncenter',
        ["object.exponents[1] = 2.5", "greater than 0 and at most 2"],
    ),
    "ring": (
        BALL,
        'kind = "torus"\naxis = [0, 0, 1]\nmajor_radius = 1\nminor_radius = 1.5\ncenter',
        ["minor_radius = 1.5", "less than major_radius"],
    ),
    "no parts": (
        OBJECT,
        'kind = "union"\nparts = []\n',
        ["object.parts = []", "a list of at least one object"],
    ),
    "kind of part": (
        OBJECT,
        'kind = "union"\nparts = [{ kind = "ball" }]\n',
        ["object.parts[0].kind = 'ball'", "allowed is elliptic_paraboloid, sphere"],
    ),
    "part's key": (
        OBJECT,
        'kind = "union"\nparts = [{ kind = "plane", point = [0, 0, 1], normal = [0, 0, 1], radius = 1 }]\n',
        ["object.parts[0].radius: unknown key", "normal"],
    ),
    "part of a part": (
        OBJECT,
        'kind = "union"\nparts = [{ kind = "union", parts = [{ kind = "sphere", center = [0, 0, 1], radius = -1 }] }]\n',
        ["object.parts[0].parts[0].radius = -1", "a number greater than 0"],
    ),
    "part to grow": (
        OBJECT,
        'kind = "offset"\nradius = 0.1\nsurface = { kind = "sphere", center = [0, 0, 1] }\n',
        ["object.surface.radius: missing", "a number greater than 0"],
    ),
    "object's unknown key": (
        "radius = 0.03",
        "radius = 0.03\ncolour = 1",
        ["object.colour: unknown key", "center"],
    ),
    "not TOML": ("length = 0.05", "length 0.05", ["not valid TOML", "line 3"]),
    "twice": ("length = 0.05", "length = 0.05\nlength = 0.06", ["not valid TOML", "line 4"]),
    "thick beyond numbers": ("radius = 0.25e-3", "radius = 1e200", ["radius"]),
    "a key of two lines": ("length = 0.05", 'length = 0.05\n"len\\ngth" = 1', ["unknown key"]),
    "endless digits": ("length = 0.05", "length = 1" + "0" * 5000, ["not valid TOML"]),
    "endless nesting": ("length = 0.05", "length = " + "[" * 5000, ["TOML"]),
}


@pytest.mark.parametrize("what", SETUP_DAMAGE)
def test_damage_to_a_setup_is_named(tmp_path: Path, what: str) -> None:
    good, bad, words = SETUP_DAMAGE[what]
    assert good in SETUP
    message = refusal(vb.load_setup, written(tmp_path, SETUP.replace(good, bad, 1)))
    assert [word for word in words if word not in message] == []


CASE_DAMAGE = {
    "empty trail": (
        "count = 9",
        "count = 0",
        ["trail[0].count = 0", "a whole number of at least 1"],
    ),
    "half a position": (
        "count = 9",
        "count = 8.5",
        ["trail[0].count = 8.5", "a whole number of at least 1"],
    ),
    "no trail": (
        CASE[CASE.index("[[trail]]") :],
        "",
        ["trail: missing", "at least one table [[trail]]"],
    ),
    "no poses": (
        CASE[CASE.index("position = ") : CASE.index("orientation = ")],
        "position = []\n",
        ["trail[1].position = []", "a list of at least one position"],
    ),
    "unequal trails": (
        "count = 9",
        "count = 7",
        ["trails have [7, 9] positions", "allowed are equal lengths"],
    ),
    "no axis": (
        "count = 9",
        "count = 9\naxis = [0, 0, 0]",
        ["axis = [0.0, 0.0, 0.0]", "non-zero length"],
    ),
    "no turn": (
        "[[0.0, 0.6, 0.0, 0.8]]",
        "[[0.0, 0.0, 0.0, 0.0]]",
        ["orientation", "zero norm", "allowed"],
    ),
    "two turns": (
        "[[0.0, 0.6, 0.0, 0.8]]",
        "[[0, 0, 0, 1], [0, 0, 0, 1]]",
        ["orientation has shape (2, 4)", "(9, 4)"],
    ),
    "kind of trail": (
        '"line"',
        '"circle"',
        ["trail[0].kind", "'circle'", "allowed is line, raster, poses, arc, whisk, spline or csv"],
    ),
    "missing start": (
        "start = [0.04, 0.005, 0.0]\n",
        "",
        ["trail[0].start: missing", "three finite numbers"],
    ),
    "another kind's key": (
        "count = 9",
        "count = 9\ntrails = 3",
        ["trail[0].trails: unknown key", "count"],
    ),
    "soft rod": (
        "6.3e-4",
        "-6.3e-4",
        ["rod.bending_stiffness = -0.00063", "a number greater than 0"],
    ),
    "thin ellipsoid": (
        "[0.03, 0.02, 0.03]",
        "[0.03, 0.0, 0.03]",
        ["object.semi_axes[1] = 0.0", "greater than 0"],
    ),
    "object's turn": (
        "[0.0, 0.0, 0.6, 0.8]",
        "[0.0, 0.0, 0.0, 0.0]",
        ["rotation", "zero norm", "allowed"],
    ),
    "negative friction": (
        "[[trail]]",
        "[contact]\nfriction = -0.1\n\n[[trail]]",
        ["contact.friction = -0.1", "a number of at least 0"],
    ),
    "endless friction": (
        "[[trail]]",
        "[contact]\nfriction = inf\n\n[[trail]]",
        ["contact.friction = inf", "a number of at least 0"],
    ),
    "friction in words": (
        "[[trail]]",
        '[contact]\nfriction = "some"\n\n[[trail]]',
        ["contact.friction = 'some'", "a number of at least 0"],
    ),
    "radius for yes": (
        "[[trail]]",
        "[contact]\nfinite_radius = 0.1\n\n[[trail]]",
        ["contact.finite_radius = 0.1", "true or false"],
    ),
    "contact's unknown key": (
        "[[trail]]",
        "[contact]\nmu = 0.1\n\n[[trail]]",
        ["contact.mu: unknown key", "friction, finite_radius"],
    ),
    "trail is no list": ('[[trail]]\nkind = "line"', '[trail]\nkind = "line"', []),
    "more than memory": ("count = 9", "count = 1000000000000000", ["count"]),
}


@pytest.mark.parametrize("what", CASE_DAMAGE)
def test_damage_to_a_case_is_named(tmp_path: Path, what: str) -> None:
    good, bad, words = CASE_DAMAGE[what]
    assert good in CASE
    message = refusal(vb.load_case, written(tmp_path, CASE.replace(good, bad, 1)))
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"\x00" * 100, b"[rod\n", b"= 1"])
def test_other_files_are_no_toml(tmp_path: Path, content: bytes) -> None:
    for load in (vb.load_setup, vb.load_case):
        assert "not valid TOML" in refusal(load, written(tmp_path, content))


def test_an_empty_file_lacks_its_tables(tmp_path: Path) -> None:
    assert "rod: missing" in refusal(vb.load_setup, written(tmp_path, ""))


def test_a_missing_file_or_a_folder_cannot_be_read(tmp_path: Path) -> None:
    for load in (vb.load_setup, vb.load_case):
        assert "cannot be read (No such file or directory)" in refusal(load, tmp_path / "none.toml")
        assert "cannot be read (Is a directory)" in refusal(load, tmp_path)


FULL = """\
preset = "ati_nano17_si_12_0_12"
rest_intervals = [[0.1, 0.9], [5.0, 6.0]]
noise_corner = 2.0
force_random_walk = 1e-4
torque_random_walk = 2e-6
orientation_noise = 1e-4
force_drift = [1e-3, 0.0, 0.0]
torque_drift = [0.0, 1e-6, 0.0]
estimate_drift = true
torque_range = [0.1, 0.2, 0.3]
cross_talk = [[1, 0, 0, 0, 0, 0], [0, 1, 0.01, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1.1]]
low_pass = { cutoff = 73.0, order = 2, delay = 0.002 }
mount = { mass = 0.02, center = [0.0, 0.001, 0.01], gravity = [0.0, 0.0, -9.81], estimated = true }
"""


def with_sensor_keys(folder: Path, keys: str, *, without: str = "tare_seconds = 0.85\n") -> Path:
    assert without in SETUP
    return written(folder, SETUP.replace(without, keys, 1))


def test_every_figure_of_the_sensor_can_be_written_down(tmp_path: Path) -> None:
    sensor = vb.load_setup(with_sensor_keys(tmp_path, FULL)).sensor
    assert sensor.rest_intervals == ((0.1, 0.9), (5.0, 6.0))
    assert (
        sensor.noise_corner,
        sensor.force_random_walk,
        sensor.torque_random_walk,
        sensor.orientation_noise,
    ) == (2.0, 1e-4, 2e-6, 1e-4)
    assert (sensor.force_drift, sensor.torque_drift, sensor.estimate_drift) == (
        (1e-3, 0, 0),
        (0, 1e-6, 0),
        True,
    )
    assert sensor.cross_talk is not None
    assert (sensor.cross_talk[1, 2], sensor.cross_talk[5, 5]) == (0.01, 1.1)
    assert sensor.low_pass == LowPass(73.0, 2, 0.002)
    assert sensor.mount == Mount(0.02, (0.0, 0.001, 0.01), (0.0, 0.0, -9.81), estimated=True)


def test_own_figures_go_before_those_of_a_preset(tmp_path: Path) -> None:
    sensor = vb.load_setup(with_sensor_keys(tmp_path, FULL)).sensor
    assert sensor.force_range == (12.0, 12.0, 17.0)
    assert sensor.torque_range == (0.1, 0.2, 0.3)
    assert sensor.force_noise == 2e-3
    plain = SETUP[SETUP.index("force_noise") : SETUP.index("position_noise")]
    bare = vb.load_setup(
        with_sensor_keys(tmp_path, 'preset = "ati_nano17_si_12_0_12"\n', without=plain)
    ).sensor
    assert (bare.force_noise, bare.torque_resolution) == (1 / 320, pytest.approx(1e-3 / 64))


def test_without_tare_seconds_the_rest_is_found(tmp_path: Path) -> None:
    assert vb.load_setup(with_sensor_keys(tmp_path, "")).sensor.tare_seconds is None
    assert vb.load_setup(written(tmp_path, SETUP.replace("= 0.85", "= 0"))).sensor.tare_seconds == 0


SENSOR_DAMAGE = {
    "preset": (
        'preset = "nano"\n',
        ["sensor.preset = 'nano'", "ati_nano17_si_12_0_12", "robotiq_ft_300_s"],
    ),
    "cross-talk": ("cross_talk = [[1, 0]]\n", ["sensor.cross_talk", "six"]),
    "cross-talk's entry": (
        FULL[FULL.index("cross_talk") : FULL.index("low_pass")].replace("1.1", "nan"),
        ["sensor.cross_talk[5][5] = nan", "finite"],
    ),
    "no inverse": (
        FULL[FULL.index("cross_talk") : FULL.index("low_pass")].replace("1.1", "0.0"),
        ["cross_talk has the condition inf"],
    ),
    "range": ("force_range = [1, 0, 1]\n", ["sensor.force_range[1] = 0", "greater than 0"]),
    "order": ("low_pass = { cutoff = 1, order = 3 }\n", ["sensor.low_pass.order = 3", "1 or 2"]),
    "filter's key": (
        "low_pass = { cut = 1 }\n",
        ["sensor.low_pass.cut: unknown key", "cutoff, order, delay"],
    ),
    "mass": ("mount = { mass = -1 }\n", ["sensor.mount.mass = -1", "at least 0"]),
    "pairs": ("rest_intervals = [[0.1]]\n", ["sensor.rest_intervals"]),
    "pairs out of order": (
        "rest_intervals = [[2.0, 1.0]]\n",
        ["rest_intervals", "allowed are pairs (start, stop)"],
    ),
    "estimate": ('estimate_drift = "yes"\n', ["sensor.estimate_drift = 'yes'", "true or false"]),
    "corner": ("noise_corner = -1\n", ["sensor.noise_corner = -1", "at least 0"]),
}


@pytest.mark.parametrize("what", SENSOR_DAMAGE)
def test_damage_to_the_sensors_keys_is_named(tmp_path: Path, what: str) -> None:
    keys, words = SENSOR_DAMAGE[what]
    message = refusal(vb.load_setup, with_sensor_keys(tmp_path, keys))
    assert [word for word in words if word not in message] == []


MISSPELT = {
    "a key": (
        ("length = 0.05", "lenght = 0.05"),
        "rod.lenght: unknown key; did you mean 'length'? allowed are kind, length, radius, "
        "youngs_modulus, density, poisson_ratio, inner_radius, yield_strain, thermal, rest, loads, support, temperature; "
        "rod.length: missing; allowed is a number greater than 0",
    ),
    "a table": (
        ("[sensor]", "[senosr]"),
        "senosr: unknown key; did you mean 'sensor'? allowed are rod, sensor, object, recording, "
        "rdt, pose, calibration, tolerances; "
        "sensor: missing; allowed is a table with clamp_position, clamp_orientation, wrench",
    ),
    "kind": (
        ('kind = "cylinder"', 'knid = "cylinder"'),
        "rod.knid: unknown key; did you mean 'kind'? "
        "rod.kind: missing; allowed is cylinder, tapered, table, uniform or unit",
    ),
    "nothing near": (
        ("radius = 0.03", "radius = 0.03\ncolour = 1"),
        "object.colour: unknown key; allowed are rotation, translation, kind, center, radius",
    ),
    "a key, and wrong values before and after it": (
        ("length = 0.05\nradius = 0.25e-3", "length = -1\nradus = 1\nyoungs_modulus = 0 #"),
        "rod.radus: unknown key; did you mean 'radius'? allowed are kind, length, radius, "
        "youngs_modulus, density, poisson_ratio, inner_radius, yield_strain, thermal, rest, loads, support, temperature; "
        "rod.radius: missing; allowed is a number greater than 0; "
        "rod.length = -1: allowed is a number greater than 0 (and 1 more)",
    ),
}


@pytest.mark.parametrize("what", MISSPELT)
def test_a_misspelt_key_comes_first_with_the_nearest_allowed_name(
    tmp_path: Path, what: str
) -> None:
    (good, bad), expected = MISSPELT[what]
    text = SETUP.replace("youngs_modulus", "# youngs_modulus") if "before" in what else SETUP
    assert good in text
    assert refusal(vb.load_setup, written(tmp_path, text.replace(good, bad, 1))) == expected


@pytest.mark.parametrize(
    ("load", "text", "words"),
    [
        (vb.load_case, CASE.replace("count = 9", "coutn = 9"), "trail[0].coutn: unknown key; did you mean 'count'?"),
        (vb.load_case, CASE.replace("[object]", "[contact]\nfricton = 1\n[object]"), "contact.fricton: unknown key; did you mean 'friction'?"),
        (vb.load_setup, SETUP + "[recording]\nforces = 'f'\n", "recording.forces: unknown key; did you mean 'force'?"),
        (vb.load_setup, SETUP + "[pose]\nkind = 'udp'\nlistn = 'udp://h:1'\n", "pose.listn: unknown key; did you mean 'listen'?"),
        (vb.load_setup, SETUP + "[rdt]\nrates = 1\n", "rdt.rates: unknown key; did you mean 'rate'?"),
        (vb.load_setup, SETUP + "[tolerances]\nlenght = 1\n", "tolerances.lenght: unknown key; did you mean 'length'?"),
    ],
)  # fmt: skip
def test_misspelt_keys_are_told_in_every_table(
    tmp_path: Path, load: Callable[[Path], object], text: str, words: str
) -> None:
    assert refusal(load, written(tmp_path, text)).startswith(words)


def test_a_list_that_is_too_short_is_one_finding(tmp_path: Path) -> None:
    text = SETUP.replace("[0.001, 0.002, 0.025]", "[0.001]")
    assert (
        refusal(vb.load_setup, written(tmp_path, text))
        == "sensor.clamp_position = [0.001]: allowed is three finite numbers"
    )
