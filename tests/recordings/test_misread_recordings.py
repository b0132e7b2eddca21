"""A good recording in other units, orders, signs and axes: named, or refused; as it is, and told
rightly, it is read without a word.
"""

import json
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import vibrissa
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.inverse.work import clamp_work, work_warnings
from vibrissa.io import InputError, RecordingWarning

HEADER = "time,px,py,pz,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz"
W_FIRST = HEADER.replace("qx,qy,qz,qw", "qw,qx,qy,qz")
PLACE, TURN, FORCE, WRENCH = slice(1, 4), slice(4, 8), slice(8, 11), slice(8, 14)

Change = Callable[[np.ndarray], None]


@pytest.fixture(scope="module")
def table(sphere_60mm: Path) -> np.ndarray:
    return np.loadtxt(sphere_60mm / "frictionless" / "trail_y-0.20.csv", delimiter=",", skiprows=1)


def scaled(columns: slice, factor: float) -> Change:
    def change(rows: np.ndarray) -> None:
        rows[:, columns] *= factor

    return change


def w_first(rows: np.ndarray) -> None:
    rows[:, TURN] = np.roll(rows[:, TURN], 1, axis=1)


def turned_back(rows: np.ndarray) -> None:
    rows[:, 4:7] *= -1


def half_turned(rows: np.ndarray) -> None:
    rows[:, [8, 9, 11, 12]] *= -1


def read(
    folder: Path, setup: Path, rows: np.ndarray, header: str = HEADER, layout: str = ""
) -> tuple[list[str], vb.Setup, vb.Reactions]:
    """Lines that are said, and what is read."""
    np.savetxt(folder / "a.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")
    (folder / "setup.toml").write_text(setup.read_text() + layout)
    loaded = vb.load_setup(folder / "setup.toml")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = vb.read_recording(folder / "a.csv", loaded)
    assert all(issubclass(one.category, RecordingWarning) for one in said)
    return [str(one.message) for one in said], loaded, found


MISTAKES: dict[str, tuple[Change, str, float]] = {
    "centimetres": (scaled(PLACE, 1e2), "positions in cm", 100.0),
    "inches": (scaled(PLACE, 1 / 0.0254), "positions in in", 39.37),
    "kilograms": (scaled(WRENCH, 1 / 9.80665), "forces in kgf", 9.5),
    "w first": (w_first, "in the order w, x, y, z", 0.5),
    "turned back": (turned_back, "from world to sensor", -0.14),
    "half turned": (half_turned, "turned by 180° about its z axis", -1.0),
    "the other sign": (scaled(WRENCH, -1.0), "a wrench of the other sign", -0.76),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named(
    tmp_path: Path, sphere_60mm: Path, table: np.ndarray, mistake: str
) -> None:
    change, words, ratio = MISTAKES[mistake]
    rows = table.copy()
    change(rows)
    said, setup, found = read(tmp_path, sphere_60mm / "setup.toml", rows)
    assert any(words in line for line in said), said
    work = clamp_work(setup.rod, found)[0]
    assert work.ratio == pytest.approx(ratio, rel=0.1)
    assert work.impossible


@pytest.mark.parametrize(
    "name",
    [
        "frictionless/trail_y-0.20.csv",
        "frictionless/trail_y-0.40.csv",
        "friction_0.25/trail_y+0.10.csv",
    ],
)
def test_work_and_energy_of_a_sound_recording_agree(sphere_60mm: Path, name: str) -> None:
    """Without friction to a few thousandths; with it the work is larger, and never comes back."""
    setup = vb.load_setup(sphere_60mm / "setup.toml")
    found = vb.reconstruct(setup.rod, vb.read_recording(sphere_60mm / name, setup))
    work = clamp_work(setup.rod, found.reactions)[0]
    if name.startswith("friction_"):
        assert 1.1 < work.ratio < 1.3
        assert work.remainder > 0.9
    else:
        assert work.ratio == pytest.approx(1, abs=0.01)
        assert abs(work.remainder) < 0.03
    assert work.gained < 0.03
    assert work_warnings(found) == ([], False, False)


def test_a_file_that_is_told_rightly_is_read_without_a_word(
    tmp_path: Path, sphere_60mm: Path, table: np.ndarray
) -> None:
    rows = table.copy()
    w_first(rows)
    layout = '\n[recording]\norientation = ["qw", "qx", "qy", "qz"]\norientation_form = "wxyz"\nposition_unit = "cm"\n'
    rows[:, PLACE] *= 100
    assert read(tmp_path, sphere_60mm / "setup.toml", rows, W_FIRST, layout)[0] == []


def test_numbers_in_the_names_of_a_quaternion_leave_its_order_open(
    tmp_path: Path, sphere_60mm: Path, table: np.ndarray
) -> None:
    rows = table[:400].copy()
    header, layout = (
        HEADER.replace("qx,qy,qz,qw", "q0,q1,q2,q3"),
        '\n[recording]\norientation = ["q0", "q1", "q2", "q3"]\n',
    )
    with pytest.raises(
        InputError,
        match=r"scalar part w comes first or last; allowed are such names with orientation_form",
    ):
        read(tmp_path, sphere_60mm / "setup.toml", rows, header, layout)
    read(tmp_path, sphere_60mm / "setup.toml", rows, header, layout + 'orientation_form = "xyzw"\n')


def test_the_way_of_a_turning_sensor_tells_the_order(
    tmp_path: Path, sphere_60mm: Path, table: np.ndarray
) -> None:
    """On an arc the sensor's position is that of a point of a turning body."""
    turn = Rotation.from_rotvec(
        np.linspace(-0.5, 0.5, len(table))[:, None] * [0.0, 1.0, 0.0]
    ) * Rotation.from_euler("xz", [0.2, 0.4])
    rows = table.copy()
    rows[:, PLACE], rows[:, TURN] = turn.apply([0.01, 0.02, 0.06]), turn.as_quat()
    words = "turns about a point"
    assert not any(words in line for line in read(tmp_path, sphere_60mm / "setup.toml", rows)[0])
    w_first(rows)
    said = [line for line in read(tmp_path, sphere_60mm / "setup.toml", rows)[0] if words in line]
    assert len(said) == 1
    assert "in the order w, x, y, z" in said[0]


def test_commands_say_it_in_one_line_and_in_json(
    tmp_path: Path,
    sphere_60mm: Path,
    table: np.ndarray,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = table.copy()
    half_turned(rows)
    read(tmp_path, sphere_60mm / "setup.toml", rows)
    monkeypatch.chdir(tmp_path)
    run = vibrissa(capsys, "reconstruct", "a.csv", "--setup", "setup.toml", "--json")
    assert run.status == 0, run.err
    lines = [
        line.removeprefix("warning: ")
        for line in run.err.splitlines()
        if line.startswith("warning: ")
    ]
    assert json.loads(run.out)["warnings"] == lines
    assert sum("turned by 180°" in line for line in lines[:-1]) == 1
    assert lines[-1].startswith("1361 of 1361 contacts are not sound; likeliest cause: a sensor")
