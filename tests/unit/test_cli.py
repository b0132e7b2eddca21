"""The command line: exit status 2 and one line for wrong input, results to stdout, files where they
were asked for.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray

EXAMPLES = Path(__file__).parents[2] / "examples"
CASE = (EXAMPLES / "cases/plane_snap_off.toml").read_text(encoding="utf-8")
SETUP = EXAMPLES / "recordings/sphere_60mm/setup.toml"
TRAIL = EXAMPLES / "recordings/sphere_60mm/trail.csv"


def _run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    from vibrissa.cli.app import main

    monkeypatch.setattr(sys, "argv", ["vibrissa", *map(str, arguments)])
    with pytest.raises(SystemExit) as stopped:
        main()
    return int(stopped.value.code or 0)


def _refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: object
) -> str:
    assert _run(monkeypatch, *arguments) == 2
    out, err = capsys.readouterr()
    lines = [line for line in err.splitlines() if line.startswith("vibrissa: error:")]
    assert out == ""
    assert len(lines) == 1
    assert "Traceback" not in err
    assert "allowed" in lines[0]
    return lines[0]


BAD_CASES = {
    "missing key": (("b = 1.0\n", ""), ["object.b", "missing"]),
    "unknown key": (("h = 0.4", "h = 0.4\nheight = 3"), ["object.height", "unknown"]),
    "unknown kind": (
        ('kind = "line"', 'kind = "zigzag"'),
        ["trail[0]", "line, raster, poses, arc, whisk, spline or csv"],
    ),
    "empty trail": (("count = 521", "count = 0"), ["trail[0].count", "0", "at least 1"]),
    "no number": (("h = 0.4", 'h = "high"'), ["object.h", "high", "finite number"]),
    "not finite": (("h = 0.4", "h = nan"), ["object.h", "nan"]),
    "not TOML": (("[rod]", "[rod"), ["not valid TOML"]),
    "negative length": (
        ('kind = "unit"', 'kind = "uniform"\nlength = -1\nbending_stiffness = 1'),
        ["rod.length", "-1", "greater than 0"],
    ),
    "zero radius": (
        ('kind = "unit"', 'kind = "cylinder"\nlength = 1\nradius = 0\nyoungs_modulus = 1'),
        ["rod.radius", "0", "greater than 0"],
    ),
    "zero axis": (("count = 521", "count = 5\naxis = [0, 0, 0]"), ["axis", "non-zero"]),
    "clamp inside": (
        ("start = [1.2, 0.0, 0.0]", "start = [0.1, 0.0, 0.9]"),
        ["trail[0]", "inside the object"],
    ),
}


@pytest.mark.parametrize("name", BAD_CASES)
def test_bad_cases(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (old, new), words = BAD_CASES[name]
    assert old in CASE
    path = tmp_path / "case.toml"
    path.write_text(CASE.replace(old, new), encoding="utf-8")
    message = _refused(monkeypatch, capsys, "scan", path)
    assert [word for word in words if word not in message] == []


def test_folders_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    for arguments in (
        ("demo", "-o", tmp_path / "file" / "demo"),
        ("scan", EXAMPLES / "cases/paper.toml", "-o", tmp_path / "file" / "scan.nc"),
        ("reconstruct", TRAIL, "--setup", SETUP, "-o", tmp_path / "file" / "contacts.ply"),
    ):
        assert str(tmp_path / "file") in _refused(monkeypatch, capsys, *arguments)
    assert "suffix" in _refused(
        monkeypatch, capsys, "reconstruct", TRAIL, "--setup", SETUP, "-o", tmp_path / "contacts.xyz"
    )


def test_scan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "case.toml"
    path.write_text(CASE, encoding="utf-8")
    output, figure = tmp_path / "scan.nc", tmp_path / "scan.png"
    assert _run(monkeypatch, "scan", path, "-o", output, "--figure", figure, "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    places = {event["kind"]: event["clamp"][0] for event in summary["events"]}
    assert places["SNAP"] == pytest.approx(-1.34212374, abs=1e-8)
    assert places["LATERAL_INSTABILITY"] == pytest.approx(0.474512782442167, abs=1e-10)
    with xarray.open_dataset(output, engine="h5netcdf") as data:
        force = data["support_force"].values
        assert summary["largest_force"] == pytest.approx(np.nanmax(np.linalg.norm(force, axis=-1)))
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_reconstruct(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    outputs = [tmp_path / f"contacts.{suffix}" for suffix in ("ply", "csv", "nc")]
    options = [part for path in outputs for part in ("-o", path)]
    assert (
        _run(
            monkeypatch,
            "reconstruct",
            TRAIL,
            "--setup",
            SETUP,
            *options,
            "--figure",
            tmp_path / "contacts.pdf",
        )
        == 0
    )
    assert "901 samples" in capsys.readouterr().out
    table = np.genfromtxt(outputs[1], delimiter=",", names=True)
    rows = np.isfinite(table["x"])
    with xarray.open_dataset(outputs[2], engine="h5netcdf") as data:
        assert np.array_equal(data["contact_point"].values[rows][:, 0], table["x"][rows])
        assert np.array_equal(data["kind"].values > 0, rows)


def test_recording_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "trail.csv"
    path.write_bytes(TRAIL.read_bytes()[:-30])
    assert "truncated" in _refused(monkeypatch, capsys, "reconstruct", path, "--setup", SETUP)


def test_friction_of_the_case_reaches_the_scan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = EXAMPLES / "cases/sphere_friction.toml"
    assert _run(monkeypatch, "scan", case, "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["friction"] == 0.25
    assert summary["motions"]["SLIP"] > 200
    assert sum(summary["motions"].values()) == summary["positions"] == 321


def test_a_finite_radius_needs_a_radius(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "case.toml"
    path.write_text(CASE + "\n[contact]\nfinite_radius = true\n", encoding="utf-8")
    assert "radius" in _refused(monkeypatch, capsys, "scan", path)


def test_friction_of_a_recording_without_any(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The shipped recording was made without friction: so says the estimate. The known coefficient
    bounds the normals by its angle.
    """
    assert (
        _run(
            monkeypatch,
            "reconstruct",
            TRAIL,
            "--setup",
            SETUP,
            "--friction",
            "0.25",
            "--estimate-friction",
            "--json",
        )
        == 0
    )
    summary = json.loads(capsys.readouterr().out)
    assert summary["normal_half_angle"] == pytest.approx(np.arctan(0.25), rel=1e-12)
    assert abs(summary["friction_estimate"]) < max(0.02, 3 * summary["friction_standard_error"])
    assert _run(monkeypatch, "reconstruct", TRAIL, "--setup", SETUP, "--estimate-friction") == 0
    assert (
        f"{summary['friction_estimate']:.3f} ± {summary['friction_standard_error']:.3f}"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize("value", ["-0.1", "nan", "inf"])
def test_no_such_friction(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], value: str
) -> None:
    assert "--friction" in _refused(
        monkeypatch, capsys, "reconstruct", TRAIL, "--setup", SETUP, "--friction", value
    )


def _faulty(folder: Path) -> Path:
    lines = TRAIL.read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines[1:]]
    for row in rows[20:24]:
        row[8:] = ["nan"] * 6
    del rows[300:303]
    path = folder / "faulty.csv"
    path.write_text("\n".join([lines[0], *map(",".join, rows)]) + "\n", encoding="utf-8")
    return path


def test_inspect_lists_every_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("inspect", _faulty(tmp_path), "--setup", SETUP)
    assert _run(monkeypatch, *arguments, "--json", "--figure", tmp_path / "inspected.png") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["counts"] == {"drop-out": 1, "gap": 1}
    assert [(fault["kind"], fault["count"]) for fault in told["faults"]] == [
        ("drop-out", 4),
        ("gap", 3),
    ]
    assert told["usable_rows"] == told["rows"] - 4
    assert told["channels"]["fx"]["noise"] == pytest.approx(
        told["channels"]["fx"]["stated_noise"], rel=0.3
    )
    assert told["tare"]["intervals"][0][0] == told["start"]
    assert (tmp_path / "inspected.png").stat().st_size > 10_000
    assert _run(monkeypatch, *arguments) == 0
    out = capsys.readouterr().out
    for words in (
        "4 rows without a number",
        "3 samples missing",
        "tare given as tare_seconds",
        "noise at rest",
    ):
        assert words in out


def test_inspect_fails_for_a_recording_that_cannot_be_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = TRAIL.read_text(encoding="utf-8").splitlines()
    lines[50], lines[51] = lines[51], lines[50]
    (tmp_path / "back.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert _run(monkeypatch, "inspect", tmp_path / "back.csv", "--setup", SETUP, "--json") == 1
    told = json.loads(capsys.readouterr().out)
    assert not told["usable"]
    assert [fault["kind"] for fault in told["faults"] if fault["unusable"]] == ["backward stamp"]
    assert "cannot be read" in _refused(
        monkeypatch, capsys, "inspect", tmp_path / "none.csv", "--setup", SETUP
    )
    assert "suffix" in _refused(
        monkeypatch, capsys, "inspect", TRAIL, "--setup", SETUP, "--figure", tmp_path / "figure.gif"
    )
