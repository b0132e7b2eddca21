"""What commands say at their end: one line, a likely cause if most is bad, one exit code each."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import vibrissa
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.paper.demo import Demo
from vibrissa.paper.statements import Statement

EXAMPLES = Path(__file__).parents[2] / "examples"
LOG = EXAMPLES / "recordings/sphere_60mm/trail.csv"
SETUP = EXAMPLES / "recordings/sphere_60mm/setup.toml"
CASE = EXAMPLES / "cases/steel_wire_sphere.toml"
NANO = "ati_nano17_si_12_0_12"


def test_reconstruct_ends_with_contacts_their_deviation_and_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cloud = tmp_path / "new" / "contacts.vtp"
    run = vibrissa(capsys, "reconstruct", LOG, "--setup", SETUP, "-o", cloud)
    assert run.out.splitlines()[-1] == f"566 contacts, 566 sound, median ±0.76 mm → {cloud}"
    assert "warning" not in run.err


@pytest.mark.parametrize(
    ("old", "new", "cause"),
    [
        ('"on_sensor"', '"on_rod"', "a wrench of the other sign"),
        ("[0.0, 0.002, 0.025] ", "[0.0, 0.0, 0.0] ", "check clamp_position"),
        ("206e9", "2060e9", "a bending stiffness (EI) 9.9 times too large?"),
        ("206e9", "20.6e9", "a bending stiffness (EI) 10 times too small?"),
        ("radius = 0.25e-3", "radius = 0.5e-3", "the rod's diameter, taken for its radius?"),
    ],
)
def test_reconstruct_names_the_likeliest_cause(
    old: str, new: str, cause: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    setup = tmp_path / "setup.toml"
    text = SETUP.read_text(encoding="utf-8")
    assert old in text
    setup.write_text(text.replace(old, new), encoding="utf-8")
    run = vibrissa(capsys, "reconstruct", LOG, "--setup", setup)
    line = run.err.splitlines()[-1]
    assert line.startswith("warning: 566 of 566 contacts are not sound; likeliest cause: ")
    assert cause in line
    assert run.out.splitlines()[-1].startswith("566 contacts, 0 sound")


def test_inspect_and_calibrate_end_with_what_they_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figure, calibrated = tmp_path / "log.png", tmp_path / "calibrated.toml"
    run = vibrissa(capsys, "inspect", LOG, "--setup", SETUP, "--figure", figure)
    assert run.out.splitlines()[-1] == f"901 rows, 901 usable, no faults → {figure}"
    command = ("calibrate", LOG, "--setup", SETUP, "--free", "youngs_modulus,length")
    run = vibrissa(capsys, *command, "-o", calibrated)
    last = f"2 parameters from 1 recording, residuals 0.99 times the noise → {calibrated}"
    assert run.out.splitlines()[-1] == last
    assert vb.load_setup(calibrated).rod.length == pytest.approx(0.05, abs=1e-4)


def test_demo_ends_with_its_statements_and_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = vb.load_case(CASE)
    scan = vb.scan(case.rod, case.surface, case.trail)

    def small(folder: Path, *_: object) -> Demo:
        held = [Statement("the rod bends", "it does", holds) for holds in (True, False)]
        found = vb.reconstruct(case.rod, scan.reactions)
        return Demo(scan, found, held, {"ten trails": 0.25}, [folder / "statements.csv"])

    monkeypatch.setattr("vibrissa.paper.run_demo", small)
    run = vibrissa(capsys, "demo", "-o", tmp_path / "demo")
    last = f"1 of 2 statements hold, 1 file → {tmp_path / 'demo'}"
    assert (run.status, run.out.splitlines()[-1]) == (1, last)


def _swapped(rows: pd.DataFrame) -> None:
    rows[["fx", "fy", "tx", "ty"]] = rows[["fy", "fx", "ty", "tx"]].to_numpy()


def _torques_against(rows: pd.DataFrame) -> None:
    rows[["tx", "ty", "tz"]] *= -1


def _turned(rows: pd.DataFrame) -> None:
    half = Rotation.from_quat((1.0, 0.0, 0.0, 0.0))
    turn = ["qx", "qy", "qz", "qw"]
    rows[turn] = (Rotation.from_quat(rows[turn].to_numpy()) * half).as_quat()


@pytest.mark.parametrize(
    ("spoil", "cause"),
    [
        (_swapped, "x and y of forces and torques swapped?"),
        (_torques_against, "torques of the other sign?"),
        (_turned, "poses turned by 180° about the sensor's x axis?"),
    ],
)
def test_inspect_and_reconstruct_name_the_same_cause(
    spoil: Callable[[pd.DataFrame], None],
    cause: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows, log = pd.read_csv(LOG), tmp_path / "log.csv"
    spoil(rows)
    rows.to_csv(log, index=False)
    for command in ("inspect", "reconstruct"):
        run = vibrissa(capsys, command, log, "--setup", SETUP)
        told = f"warning: 566 of 566 contacts are not sound; likeliest cause: {cause}"
        assert run.err.splitlines()[-1] == told
    assert "standard deviations: likely" not in run.err


def test_inspect_says_what_spoils_most_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, log = pd.read_csv(LOG), tmp_path / "log.csv"
    rows["px"] *= 1e3
    rows.to_csv(log, index=False)
    run = vibrissa(capsys, "inspect", log, "--setup", SETUP)
    assert run.status == 1
    assert "positions px,py,pz extend over 80 m (in mm?) with a rod of 0.05 m" in run.err
    assert run.out.splitlines()[-1].startswith("901 rows, not usable as read, 1 units")
    rows = pd.read_csv(LOG)
    rows["fx"] = rows["fx"].clip(0.3, 0.32)  # about its value at rest
    rows.to_csv(log, index=False)
    run = vibrissa(capsys, "inspect", log, "--setup", SETUP)
    assert run.status == 0
    assert " rows are unusable; likeliest cause: stuck channel, such as fx is stuck at " in run.err


def test_a_recording_without_contact_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "rest.csv"
    log.write_text("".join(LOG.read_text(encoding="utf-8").splitlines(keepends=True)[:130]))
    run = vibrissa(capsys, "reconstruct", log, "--setup", SETUP)
    assert "warning: no contact was found; likeliest cause: the loads never exceed" in run.err
    assert run.out.splitlines()[-1] == "0 contacts, 0 sound"


def test_a_scan_that_touches_nothing_and_a_list_of_events(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = vibrissa(capsys, "scan", CASE)
    lines = run.out.splitlines()
    assert "32 events: 9 first_contact, 8 detach, 7 tip_to_tangential" in run.out
    assert sum(line.startswith("trail ") for line in lines) == 6
    assert "and 26 more events: --json lists all" in lines
    assert lines[-1] == "1909 contacts, 1748 sound"
    case = tmp_path / "case.toml"
    case.write_text(
        '[rod]\nkind = "cylinder"\nlength = 0.05\nradius = 0.25e-3\nyoungs_modulus = 206e9\n'
        '[object]\nkind = "sphere"\ncenter = [0.0, 0.0, 57.5]\nradius = 30.0\n'
        '[[trail]]\nkind = "line"\nstart = [0.04, 0.0, 0.0]\nstop = [-0.04, 0.0, 0.0]\ncount = 9\n'
    )
    run = vibrissa(capsys, "scan", case)
    assert "closer than 27.5 m to the object, and the rod is 0.05 m long" in run.err
    assert "millimetres?" in run.err


def test_expect_maps_the_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figure = tmp_path / "map.png"
    run = vibrissa(capsys, "expect", CASE, "--sensor", NANO, "--figure", figure)
    assert run.status == 0
    assert run.out.startswith(f"{NANO}: 1900 of 1909 contacts detected, median ±1.1 mm")
    assert run.out.endswith(f"→ {figure}\n")
    assert figure.read_bytes().startswith(b"\x89PNG")
    summary = json.loads(vibrissa(capsys, "expect", CASE, "--sensor", NANO, "--json").out)
    assert summary["median_root_mean_square"] == pytest.approx(1.1e-3, rel=0.05)
    far, text = tmp_path / "far.toml", CASE.read_text(encoding="utf-8")
    assert "0.0575" in text
    far.write_text(text.replace("0.0575", "0.5"), encoding="utf-8")
    run = vibrissa(capsys, "expect", far, "--sensor", NANO, "--figure", tmp_path / "far.png")
    assert (run.status, (tmp_path / "far.png").exists()) == (1, False)
    assert run.out == f"{NANO}: 0 of 0 contacts detected\n"
    assert "far.png: no contact of the scan is detected" in run.err.splitlines()[-1]


WRONG = {
    "scan": ("scan", "none.toml"),
    "reconstruct": ("reconstruct", "none.csv", "--setup", SETUP),
    "inspect": ("inspect", "none.csv", "--setup", SETUP),
    "convert": ("convert", "none.csv", "--setup", SETUP, "-o", "x.csv"),
    "convert to nothing": ("convert", LOG, "--setup", SETUP, "-o", "x.doc"),
    "calibrate": ("calibrate", "none.csv", "--setup", SETUP),
    "expect": ("expect", CASE, "--sensor", "none"),
    "expect without noise": ("expect", CASE, "--sensor", "ati_axia80_m20_si_500_20"),
    "live": ("live", "--source", "replay:none.csv", "--setup", SETUP),
    "simulate-sensor": ("simulate-sensor", "none.toml", "--setup", SETUP),
    "usage": ("scan", CASE, "--none"),
}


@pytest.mark.parametrize("what", WRONG)
def test_invalid_input_has_status_2(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run = vibrissa(capsys, *WRONG[what])
    assert (run.status, run.out) == (2, "")
    assert list(tmp_path.iterdir()) == []


def test_json_lines_need_no_mcap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("mcap", "mcap.records", "mcap.data_stream", "vibrissa.io.rosbag"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "vibrissa.io.sinks", raising=False)
    lines = tmp_path / "x.jsonl"
    run = vibrissa(
        capsys, "live", "--source", f"replay:{LOG}?speed=max", "--setup", SETUP, "--sink", lines
    )
    assert run.status == 0, run.err
    rows = [json.loads(line) for line in lines.read_text(encoding="utf-8").splitlines()]
    assert np.sum([row["kind"] != "NONE" for row in rows]) > 500
    assert run.err.splitlines()[-1].endswith(f"sound → {lines}")


def test_tables_and_lists_in_a_pipe_are_a_hundred_wide(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = LOG.read_text(encoding="utf-8").splitlines()
    (tmp_path / "back.csv").write_text("\n".join([lines[0], *lines[:0:-1]]) + "\n")
    for arguments, words in (
        (("example",), "tilted_clamp_ellipsoid  A tilted clamp"),
        (("inspect", tmp_path / "back.csv", "--setup", SETUP), "no stamp is later"),
    ):
        out = vibrissa(capsys, *arguments).out
        assert words in out
        assert 80 < max(map(len, out.splitlines())) <= 100
