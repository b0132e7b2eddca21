"""What `inspect` says of a recording is all that reading did to it: also what bringing two streams
together would hide.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from bench_files import recording_table
from command_line import vibrissa
from test_recording_layout import TWO_FILES, load, text, two_files

from vibrissa.io import InputError, inspect_recording, read_recording


def told(file: Path, setup: object) -> list[tuple[str, tuple[str, ...], int, bool]]:
    return [
        (str(fault.kind), fault.channels, fault.count, fault.unusable)
        for fault in inspect_recording(file, setup).faults
    ]


@pytest.mark.parametrize("rows", [slice(7, 8), slice(0, 40)])
def test_a_quaternion_of_another_norm_is_found_by_inspection_too(
    tmp_path: Path, rows: slice
) -> None:
    table = recording_table()
    table[rows, 4:8] *= 1.1
    (tmp_path / "a.csv").write_text(text(table))
    setup = load(tmp_path)
    found = [
        fault for fault in inspect_recording(tmp_path / "a.csv", setup).faults if fault.unusable
    ]
    assert [(str(fault.kind), fault.channels, fault.count) for fault in found] == [
        ("units", ("orientation",), rows.stop - rows.start)
    ]
    assert found[0].start == pytest.approx(table[rows.start, 0])
    assert found[0].stop == pytest.approx(table[rows.stop - 1, 0])
    with pytest.raises(InputError, match=r"has the norm 1\.1"):
        read_recording(tmp_path / "a.csv", setup)


def test_faults_of_poses_with_stamps_of_their_own_are_found(tmp_path: Path) -> None:
    time = np.arange(0, 3, 0.01)
    file = two_files(tmp_path, time, np.arange(-0.1, 3.1, 0.02))
    setup = load(tmp_path, TWO_FILES)
    good = told(file, setup)
    lines = (tmp_path / "ft_tool.csv").read_text().splitlines()
    lines[30] = ",".join(["nan", *lines[30].split(",")[1:]])
    lines[50] = ",".join([lines[50].split(",")[0], "nan", *lines[50].split(",")[2:]])
    lines[70] = lines[69]
    del lines[100:103]
    (tmp_path / "ft_tool.csv").write_text("\n".join(lines) + "\n")
    channels = ("position", "orientation")
    new = [fault for fault in told(file, setup) if fault not in good]
    kinds = [("drop-out", 2), ("duplicate stamp", 1), ("gap", 1), ("gap", 1), ("gap", 3)]
    assert sorted(new) == [(kind, channels, count, False) for kind, count in kinds]


def test_poses_that_run_back_make_a_recording_unusable_in_both(tmp_path: Path) -> None:
    time = np.arange(0, 3, 0.01)
    pose_time = np.arange(-0.1, 3.1, 0.02)
    file = two_files(tmp_path, time, np.where(pose_time > 1.5, pose_time - 0.5, pose_time))
    setup = load(tmp_path, TWO_FILES)
    assert ("backward stamp", ("position", "orientation")) in [
        fault[:2] for fault in told(file, setup) if fault[3]
    ]
    with pytest.raises(InputError, match="allowed are increasing times"):
        read_recording(file, setup)


def test_what_was_left_out_is_one_line_on_stderr_and_part_of_what_inspect_prints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time = np.arange(0, 3, 0.01)
    two_files(tmp_path, time, np.arange(0.2049, 2.5, 0.01))
    load(tmp_path, TWO_FILES)
    file, setup = tmp_path / "ft.csv", ("--setup", tmp_path / "setup.toml")
    left_out = "of 300 wrenches lie before the first or after the last pose and are left out"
    run = vibrissa(capsys, "reconstruct", file, *setup, "--json")
    assert run.status == 0, run.err
    assert json.loads(run.out)["samples"] == 229
    said = [line for line in run.err.splitlines() if left_out in line]
    assert said == [f"vibrissa: warning: {file}: 71 {left_out}"]
    assert "RecordingWarning" not in run.err
    run = vibrissa(capsys, "inspect", file, *setup, "--json")
    assert json.loads(run.out)["notes"] == [f"71 {left_out}"]


def test_stamps_in_milliseconds_are_named_where_they_leave_no_rest(tmp_path: Path) -> None:
    table = recording_table()
    table[:, 0] *= 1e3
    (tmp_path / "a.csv").write_text(text(table))
    with pytest.raises(
        InputError,
        match=r"tare_seconds = 0\.85: 1 of 40 samples.*also: 0\.01 samples a second.*milliseconds",
    ):
        read_recording(tmp_path / "a.csv", load(tmp_path))
