"""The calibrated setup as a file, and the command that writes it."""

import json
import os
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from bench_files import SETUP
from calibration_bench import WIRE, recordings, sensor, setup, wrong
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.io import InputError, write_calibration, write_recording
from vibrissa.io.calibration_report import findings

DATE = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


@pytest.fixture(scope="module")
def found() -> vb.Calibration:
    noisy = sensor(0.1)
    return vb.calibrate(
        recordings(noisy),
        wrong(setup(noisy)),
        free=(
            "youngs_modulus",
            "length",
            "clamp_position",
            "clamp_orientation",
            "object_position",
            "tare",
        ),
    )


def _written(
    found: vb.Calibration, tmp_path: Path, text: str = SETUP, name: str = "calibrated.toml"
) -> Path:
    (tmp_path / "setup.toml").write_text(text, encoding="utf-8")
    return write_calibration(
        tmp_path / name, found, tmp_path / "setup.toml", ["a/one.csv", "two.csv"], date=DATE
    )


ROD = 'kind = "cylinder"\nlength = 0.05\nradius = 0.25e-3\nyoungs_modulus = 206e9\n'


@pytest.mark.parametrize(
    "rod",
    [
        ROD.replace("cylinder", "tapered").replace("radius", "base_radius") + "tip_radius = 1e-4",
        'kind = "table"\narc_length = [0, 0.02, 0.05]\nradius = [3e-4, 3e-4, 2e-4]\n'
        "youngs_modulus = 2e9",
        'kind = "table"\narc_length = [0, 0.05]\nbending_stiffness = [1e-3, 2e-3]\n'
        "torsional_stiffness = [1e-3, 1e-3]",
        ROD + "temperature = 60\n[rod.thermal]\nmodulus_slope = -3e-4\nexpansion = 1e-5",
    ],
)
def test_rods_of_any_kind_get_their_stiffness_and_length(
    found: vb.Calibration, tmp_path: Path, rod: str
) -> None:
    assert ROD in SETUP
    loaded = vb.load_setup(_written(found, tmp_path, SETUP.replace(ROD, rod + "\n"))).rod
    calibrated = found.setup.rod
    assert loaded.bending_stiffness == pytest.approx(calibrated.bending_stiffness, rel=1e-14)
    assert loaded.length == pytest.approx(calibrated.length, rel=1e-14)


def test_the_file_holds_what_was_found(found: vb.Calibration, tmp_path: Path) -> None:
    loaded = vb.load_setup(_written(found, tmp_path))
    assert loaded.rod.length == found.setup.rod.length
    assert loaded.rod.bending_stiffness == pytest.approx(
        found.setup.rod.bending_stiffness, rel=1e-15
    )
    np.testing.assert_array_equal(loaded.sensor.clamp_position, found.setup.sensor.clamp_position)
    np.testing.assert_allclose(
        loaded.sensor.clamp_orientation, found.setup.sensor.clamp_orientation, atol=1e-15
    )
    points = np.random.default_rng(0).normal(0, 0.05, (20, 3))
    np.testing.assert_allclose(
        loaded.surface.levels(points), found.surface.levels(points), atol=1e-12
    )
    assert loaded.calibration is not None
    np.testing.assert_allclose(
        loaded.calibration.covariance(),
        found.covariance,
        rtol=1e-6,
        atol=1e-9 * np.abs(found.covariance).max(),
    )
    assert (loaded.calibration.recordings, loaded.calibration.date) == (
        ["one.csv", "two.csv"],
        DATE,
    )
    assert loaded.calibration.not_determined == ["clamp_orientation_z"]


def test_what_was_not_calibrated_is_kept(found: vb.Calibration, tmp_path: Path) -> None:
    text = SETUP.replace("[sensor]", "# the sensor on the bench\n[sensor]")
    lines = _written(found, tmp_path, text).read_text(encoding="utf-8").splitlines()
    calibrated = ("length", "youngs_modulus", "clamp_position", "clamp_orientation")
    assert [
        line for line in text.splitlines() if not line.startswith(calibrated) and line not in lines
    ] == []


def test_a_calibrated_setup_is_calibrated_again_in_place(
    found: vb.Calibration, tmp_path: Path
) -> None:
    path = _written(found, tmp_path)
    once = path.read_text(encoding="utf-8")
    write_calibration(path, found, path, ["one.csv"], date=DATE)
    assert (
        once.count("[calibration]") == path.read_text(encoding="utf-8").count("[calibration]") == 1
    )


def test_an_object_that_was_placed_is_placed_anew(found: vb.Calibration, tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.3, 0.1, -0.2])
    text = (
        SETUP.replace(
            'kind = "sphere"\nradius = 0.03', 'kind = "ellipsoid"\nsemi_axes = [0.03, 0.02, 0.01]'
        )
        + f"rotation = {turn.as_quat().tolist()}\n"
    )
    before, after = (
        vb.load_setup(path).surface
        for path in (
            _written(found, tmp_path).with_name("setup.toml"),
            _written(found, tmp_path, text),
        )
    )
    assert before is not None
    points = np.random.default_rng(0).normal(0, 0.05, (20, 3))
    rotation, move = found.pose
    (tmp_path / "plain.toml").write_text(text, encoding="utf-8")
    plain = vb.load_setup(tmp_path / "plain.toml").surface
    np.testing.assert_allclose(
        after.levels(points), plain.levels((points - move) @ rotation), atol=1e-12
    )


def test_a_mesh_is_still_found_from_another_folder(found: vb.Calibration, tmp_path: Path) -> None:
    mesh = Path(__file__).parents[2] / "examples/meshes/mug.ply"
    (tmp_path / "mug.ply").write_bytes(mesh.read_bytes())
    text = SETUP.replace(
        'kind = "sphere"\nradius = 0.03\ncenter = [0.0, 0.0, 0.0575]',
        'kind = "union"\n[[object.parts]]\nkind = "mesh"\nfile = "mug.ply"\nscale = 1e-3',
    )
    path = _written(found, tmp_path, text, "elsewhere/deep/calibrated.toml")
    assert 'file = "../../mug.ply"' in path.read_text(encoding="utf-8")


def test_a_motion_is_still_found_from_another_folder(found: vb.Calibration, tmp_path: Path) -> None:
    text = SETUP + '\n[pose]\nkind = "trail"\npath = "motions/robot.csv"\n'
    loaded = vb.load_setup(_written(found, tmp_path, text, "elsewhere/calibrated.toml"))
    assert loaded.pose is not None
    assert (tmp_path / "elsewhere" / loaded.pose.path).resolve() == tmp_path / "motions/robot.csv"


def test_the_file_notes_what_was_said(found: vb.Calibration, tmp_path: Path) -> None:
    said = replace(found, warnings=["length: found 9.0% from where it was given"])
    table = vb.load_setup(_written(said, tmp_path)).calibration
    assert table is not None
    assert table.warnings == said.warnings
    assert table.held_out == pytest.approx(
        [part.reduced_chi_square for part in found.held_out], rel=1e-3
    )
    assert any("noise only" in line for line in findings(found))


BAD = {
    "format": (
        "format = 1",
        "format = 2",
        "calibration.format = 2: allowed is 1, the format that this version",
    ),
    "unknown key": (
        "friction = 0.0",
        "friction = 0.0\nlikes = 3",
        "calibration.likes: unknown key",
    ),
    "no number": ("rows = ", 'rows = "many" #', "calibration.rows = 'many'"),
    "name of no estimate": (
        'names = ["youngs_modulus"',
        'names = ["hardness"',
        "calibration.names[0] = 'hardness'; allowed is each once of",
    ),
    "name twice": (
        'names = ["youngs_modulus"',
        'names = ["length"',
        "calibration.names[1] = 'length'; allowed is each once of",
    ),
    "no matrix": (
        "correlation = [",
        "correlation = [\n  [1.0],",
        "calibration.correlation has 11 rows of [1, 10] numbers; allowed are 10 of 10",
    ),
    "estimate": ('unit = "Pa"', 'unit = "Pa"\nguess = 1', "calibration.estimates.youngs_modulus"),
}


@pytest.mark.parametrize("what", BAD)
def test_a_damaged_table_is_named(found: vb.Calibration, tmp_path: Path, what: str) -> None:
    old, new, message = BAD[what]
    path = _written(found, tmp_path)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        vb.load_setup(path)
    assert message in str(caught.value)


def test_a_rod_in_the_model_s_units_cannot_hold_it(found: vb.Calibration, tmp_path: Path) -> None:
    text = SETUP.replace(
        'kind = "cylinder"\nlength = 0.05\nradius = 0.25e-3\nyoungs_modulus = 206e9',
        'kind = "unit"',
    )
    with pytest.raises(InputError, match=r"rod\.kind = 'unit'"):
        _written(found, tmp_path, text)


def _run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    from vibrissa.cli.app import main

    monkeypatch.setattr(sys, "argv", ["vibrissa", "calibrate", *map(str, arguments)])
    monkeypatch.setattr(os, "environ", dict(os.environ))
    with pytest.raises(SystemExit) as stopped:
        main()
    return int(stopped.value.code or 0)


@pytest.fixture
def bench(tmp_path: Path) -> list[Path]:
    """A setup that is off, and two recordings."""
    noisy = sensor()
    x, y, z, w = noisy.clamp_orientation
    text = SETUP.replace("[0.001, 0.002, 0.025]", "[0.004, -0.003, 0.021]").replace(
        "[0.0, 0.0, 0.0, 1.0]", f"[{x}, {y}, {z}, {w}]"
    )
    text = (
        text.replace("[0.0, 0.0, 0.001]", "[0.001, 0.0, 0.002]")
        .replace("206e9", "170e9")
        .replace("tare_seconds = 0.85", "tare_seconds = 1.5")
    )
    (tmp_path / "setup.toml").write_text(text, encoding="utf-8")
    raws = recordings(noisy)
    return [
        tmp_path / "setup.toml",
        *(write_recording(tmp_path / f"{index}.csv", raw) for index, raw in enumerate(raws)),
    ]


def test_the_command(
    bench: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    start, *rows = bench
    output, report = tmp_path / "calibrated.toml", tmp_path / "report"
    assert (
        _run(monkeypatch, *rows, "--setup", start, "-o", output, "--report", report, "--json") == 0
    )
    summary = json.loads(capsys.readouterr().out)
    low, high = summary["estimates"]["youngs_modulus"]["interval_95"]
    assert low - (high - low) < 206e9 < high + (high - low)
    loaded = vb.load_setup(output)
    assert (
        loaded.rod.length
        == summary["estimates"]["length"]["value"]
        == pytest.approx(WIRE.length, rel=0.005)
    )
    assert json.loads((report / "summary.json").read_text()) == summary
    assert "| youngs_modulus | GPa |" in (report / "summary.md").read_text()
    for name in (
        "residuals_over_time",
        "residual_histogram",
        "residuals_over_force",
        "parameter_correlation",
    ):
        assert (report / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_refuses(
    bench: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Status 2 for wrong usage, 1 for recordings that do not do."""
    start, row, _ = bench
    text = start.read_text(encoding="utf-8")
    plane = tmp_path / "lone.csv"
    unit = tmp_path / "unit.toml"
    unit.write_text('[rod]\nkind = "unit"\n' + text[text.index("[sensor]") :], encoding="utf-8")
    plane.write_text(
        "\n".join(row.read_text(encoding="utf-8").splitlines()[:100]) + "\n", encoding="utf-8"
    )
    for status, message, arguments in (
        (
            2,
            "free: 'stiffness' is no parameter; allowed are youngs_modulus",
            (row, "--setup", start, "--free", "stiffness"),
        ),
        (
            2,
            "--prior = 'length'; allowed is NAME=DEVIATION",
            (row, "--setup", start, "--prior", "length"),
        ),
        (
            2,
            "--prior = 'length=2': 'length' is given twice",
            (row, "--setup", start, "--prior", "length=1", "--prior", "length=2"),
        ),
        (2, f"{row}: is given twice", (row, row, "--setup", start)),
        (
            2,
            "rod.kind = 'unit' cannot hold a calibrated rod",
            (row, "--setup", unit, "-o", tmp_path / "out.toml"),
        ),
        (1, "friction = 1e+09", (row, "--setup", start, "--free", "length", "--friction", "1e9")),
        (
            2,
            "suffix '.json'; allowed are .toml",
            (row, "--setup", start, "-o", tmp_path / "out.json"),
        ),
        (1, f"{plane}: 0 samples are in contact", (plane, "--setup", start)),
    ):
        assert _run(monkeypatch, *arguments) == status
        out, err = capsys.readouterr()
        assert out == ""
        assert message in err
        assert "Traceback" not in err
