"""`vibrissa init`: foreign logs of one and the same sweep give setups that read them to the same
reactions.
"""

import io
import sys
from collections.abc import Callable
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from command_line import status_of, vibrissa
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.io.recordings.names import groups
from vibrissa.sensor import RawRecording

BENCH = Path(__file__).parents[2] / "examples/bench"
MEASURED = (
    *("--length", "49.5mm", "--radius", "0.25mm", "--youngs-modulus", "200 GPa"),
    *("--clamp-position", "0, 0, 25.5 mm"),
)


@pytest.fixture(scope="module")
def raw() -> RawRecording:
    """A sweep under a ball, the sensor turned by 30° about z; readings are the load on it. Every
    third sample, as each of many readings of a file takes all of them.
    """
    whole = vb.io.read_raw(BENCH / "ball_1.csv", vb.load_setup(BENCH / "setup.toml")).raw
    return rows_of(whole, np.s_[::3])


@pytest.fixture(scope="module")
def truth(raw: RawRecording) -> vb.Reactions:
    sensor = vb.load_setup(BENCH / "setup.toml").sensor.updated(tare_seconds=None)
    return sensor.reactions(raw)


def rows_of(raw: RawRecording, rows: Any) -> RawRecording:
    """Some rows of a recording."""
    return RawRecording(*(part[rows] for part in astuple(raw)))


def german(raw: RawRecording, folder: Path) -> Path:
    """A logger's preamble, semicolons and decimal commas, Latin letters, a robot's angles A, B, C."""
    angles = Rotation.from_quat(raw.orientation).as_euler("ZYX", degrees=True)
    table = pd.DataFrame({"Zeit [ms]": 1e3 * raw.time})
    for place, axis in enumerate("XYZ"):
        table[f"Kraft {axis} [N]"] = raw.force[:, place]
        table[f"Drehmoment {axis} [Nmm]"] = 1e3 * raw.torque[:, place]
        table[f"Position {axis} [mm]"] = 1e3 * raw.position[:, place]
    for place, axis in enumerate("ABC"):
        table[f"{axis} [°]"] = angles[:, place]
    table["Temperatur [°C]"] = 21.5
    text = "Messung 3;Prüfer: Müller\nGerät;K6D\n\n" + table.to_csv(
        sep=";", decimal=",", index=False
    )
    path = folder / "messung.csv"
    path.write_bytes(text.encode("cp1252"))
    return path


def unlabelled(raw: RawRecording, folder: Path) -> Path:
    """The support reaction, in mN and N mm, positions in mm, q0 to q3 with w first, stamps in µs:
    no unit is stated.
    """
    table = pd.DataFrame({"timestamp": np.round(1e6 * raw.time)})
    for place in range(3):
        table[f"F{place}"] = -1e3 * raw.force[:, place]
    for place in range(3):
        table[f"T{place}"] = -1e3 * raw.torque[:, place]
    for place, axis in enumerate("XYZ"):
        table[axis] = 1e3 * raw.position[:, place]
    for place in range(4):
        table[f"q{place}"] = np.roll(raw.orientation, 1, axis=1)[:, place]
    path = folder / "log.txt"
    table.to_csv(path, sep="\t", index=False)
    return path


def robot(raw: RawRecording, folder: Path) -> Path:
    """Poses as a rotation vector and a wrench of six numbers, beside those of the target."""
    turns = Rotation.from_quat(raw.orientation).as_rotvec()
    table = pd.DataFrame({"timestamp": raw.time})
    six = {
        "target_TCP_pose": np.hstack([raw.position + 0.01, turns]),
        "actual_TCP_pose": np.hstack([raw.position, turns]),
        "actual_TCP_force": raw.wrench,
    }
    for name, numbers in six.items():
        for place in range(6):
            table[f"{name}_{place}"] = numbers[:, place]
    path = folder / "record.csv"
    table.to_csv(path, sep=" ", index=False)
    return path


def units_below(raw: RawRecording, folder: Path) -> Path:
    """Names with suffixes, units in the line below, w of the quaternion in front."""
    turn = np.roll(raw.orientation, 1, axis=1)
    numbers = np.column_stack([raw.time, 1e3 * raw.force, 1e3 * raw.torque, 1e2 * raw.position])
    names = "t F_x F_y F_z M_x M_y M_z pos_x pos_y pos_z quat_w quat_x quat_y quat_z"
    table = pd.DataFrame(np.column_stack([numbers, turn]), columns=names.split())
    head, _, rows = table.to_csv(index=False).partition("\n")
    stated = ",".join(["s", *["mN"] * 3, *["mN*m"] * 3, *["cm"] * 3, *["-"] * 4])
    path = folder / "export.csv"
    path.write_text(f"{head}\n{stated}\n{rows}")
    return path


def hdf5(raw: RawRecording, folder: Path) -> Path:
    """Arrays of six and seven columns in a group, and others that mean nothing."""
    path = folder / "log.h5"
    with h5py.File(path, "w") as file:
        file["log/t"] = raw.time
        file["log/ft"] = raw.wrench
        file["log/pose"] = np.hstack([raw.position, raw.orientation])
        file["log/joints"] = np.zeros((len(raw.time), 7))
        file["log/operator"] = "me"
    return path


def matlab(raw: RawRecording, folder: Path) -> Path:
    """A struct of matrices."""
    path = folder / "log.mat"
    held = {
        "time": raw.time,
        "force": raw.force,
        "torque": raw.torque,
        "position": raw.position,
        "quaternion": raw.orientation,
    }
    savemat(path, {"trial": held})
    return path


def units_behind(raw: RawRecording, folder: Path) -> Path:
    """Units behind a bar or underscore, of which N and m could be a name; comments above."""
    table = pd.DataFrame({"elapsed_ms": 1e3 * raw.time})
    angles = Rotation.from_quat(raw.orientation).as_euler("xyz", degrees=True)
    for place, axis in enumerate("xyz"):
        table[f"F_{axis}/mN"] = 1e3 * raw.force[:, place]
        table[f"Kraft_Moment_{axis}_Nmm"] = 1e3 * raw.torque[:, place]
        table[f"UR5_{axis}_m"] = raw.position[:, place]
        table[("roll_deg", "pitch_deg", "yaw_deg")[place]] = angles[:, place]
    table["temp_C"] = 21.5
    path = folder / "log.csv"
    path.write_text("# rig 3\n% time: 12:00\n" + table.to_csv(index=False))
    return path


def dates(raw: RawRecording, folder: Path) -> Path:
    """Dates, a tool's rotation vector, names of nothing but a place in a tree."""
    stamps = pd.to_datetime((1e9 * raw.time).round().astype("int64"))
    table = pd.DataFrame({"Timestamp": stamps.strftime("%Y-%m-%dT%H:%M:%S.%fZ")})
    turns = Rotation.from_quat(raw.orientation).as_rotvec()
    for place, axis in enumerate("xyz"):
        table[f"ft.{axis}"] = raw.force[:, place]
        table[f"tq.{axis}"] = raw.torque[:, place]
        table[f"Arm/{axis}"] = raw.position[:, place]
        table[f"Arm/r{axis}"] = turns[:, place]
    path = folder / "log.csv"
    table.to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    "write", [german, unlabelled, robot, units_below, units_behind, dates, hdf5, matlab]
)
def test_a_foreign_log_is_understood(
    write: Callable[[RawRecording, Path], Path],
    raw: RawRecording,
    truth: vb.Reactions,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Names, units, decimal sign, encoding, quaternion order and sign, none of them given."""
    log, setup = write(raw, tmp_path), tmp_path / "setup.toml"
    done = vibrissa(capsys, "init", log, "-o", setup, *MEASURED)
    assert done.status == 0, done.err
    assert "warning" not in done.err
    assert done.out.endswith(f"→ {setup}\n") and len(done.out.splitlines()) == 1
    loaded = vb.load_setup(setup)
    assert loaded.rod.length == 0.0495 and loaded.rod.bending_stiffness == pytest.approx(
        200e9 * np.pi / 4 * 0.25e-3**4
    )
    assert loaded.sensor.wrench == ("on_rod" if write is unlabelled else "on_sensor")
    found = vb.read_recording(log, loaded)
    np.testing.assert_allclose(found.force, truth.force, atol=1e-6)
    np.testing.assert_allclose(found.moment, truth.moment, atol=1e-8)
    np.testing.assert_allclose(found.trail.position, truth.trail.position, atol=1e-8)
    np.testing.assert_allclose(found.time, truth.time, atol=1e-8)
    noise = np.array(loaded.sensor.force_noise)
    assert np.all(abs(noise / 2.05e-3 - 1) < 0.2)


def test_what_a_first_setup_says_of_real_rods_is_read_when_uncommented(
    raw: RawRecording, tmp_path: Path
) -> None:
    log, setup = matlab(raw, tmp_path), tmp_path / "setup.toml"
    assert status_of("init", log, "-o", setup, *MEASURED) == 0
    head, tail = setup.read_text(encoding="utf-8").split("[sensor]")
    lines = [line.removeprefix("# ") for line in head.splitlines() if "tapered" not in line]
    assert all("#" in line for line in lines if " = " in line and "kind" not in line), "units"
    text = "\n".join(line for line in lines[1:] if "What else" not in line) + "\n[sensor]" + tail
    setup.write_text(text, encoding="utf-8")
    rod = vb.load_setup(setup).rod
    assert rod.rest == vb.RestShape.arc(0.5 * (1 + 15 * 11.5e-6))
    assert rod.loads == vb.Loads(gravity=(0, 0, -9.81), wind=(0, 0, 0))
    assert rod.support == vb.Support.pivot((10, 10, 10))
    assert rod.thermal is not None and rod.thermal.reference == 35.0
    assert (rod.poisson_ratio, rod.yield_strain) == (0.3, 0.008)


def test_poses_in_a_file_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file whose name begins with the log's, with another delimiter; names are printed too."""
    monkeypatch.chdir(tmp_path)
    assert status_of("example", "bench") == 0
    assert status_of("init", "bench/ball_1.csv", "-o", "bench/first.toml", *MEASURED) == 0
    setup = vb.load_setup("bench/first.toml")
    assert setup.recording is not None and setup.recording.pose_file == "{name}_robot.csv"
    for name in ("ball_1", "bar_2"):
        assert len(vb.read_recording(f"bench/{name}.csv", setup).force) > 2000
    true = vb.load_setup(BENCH / "setup.toml")
    true = replace(true, sensor=true.sensor.updated(tare_seconds=None))
    found, given = (vb.read_recording(BENCH / "ball_1.csv", one).force for one in (setup, true))
    np.testing.assert_allclose(found, given, atol=1e-9)
    text = Path("bench/first.toml").read_text(encoding="utf-8")
    assert "1.00 for on_sensor, -0.77 for on_rod; 1 is right" in text


def test_the_sign_is_asked_for_if_the_data_cannot_tell(
    raw: RawRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log that ends before the first contact."""
    log, setup = tmp_path / "early.csv", tmp_path / "setup.toml"
    vb.io.write_recording(log, rows_of(raw, raw.time < 2.2))
    refused = vibrissa(capsys, "init", log, "-o", setup, *MEASURED)
    assert refused.status == 2 and not setup.exists()
    assert "--wrench: missing; allowed is on_sensor or on_rod" in refused.err
    assert len(refused.err.splitlines()) == 1
    given = vibrissa(capsys, "init", log, "-o", setup, *MEASURED, "--wrench", "on_sensor")
    assert given.status == 0 and "wrench on_sensor → " in given.out
    assert vb.load_setup(setup).sensor.sign == -1


def test_a_sign_that_the_work_contradicts_is_warned_of(
    raw: RawRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, setup = unlabelled(raw, tmp_path), tmp_path / "setup.toml"
    wrong = (
        "--wrench",
        "on_sensor",
        *(
            f"--layout={key}"
            for key in (
                "orientation_form=wxyz",
                "force_unit=mN",
                "torque_unit=N mm",
                "position_unit=mm",
            )
        ),
    )
    said = vibrissa(capsys, "init", log, "-o", setup, *MEASURED, *wrong)
    assert said.status == 0 and "-0.77 (on_sensor) times the rod's bending energy" in said.err


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ((), "--length: missing; allowed is the rod's free length"),
        (("--length", "50 kg"), "--length = '50 kg'; allowed is a number in m"),
        ((*MEASURED, "--length", "-1"), "length = -1.0"),
        (
            (*MEASURED, "--length", "81"),
            "--length = '81': that is in metres; allowed are up to 2 m",
        ),
        ((*MEASURED, "--sensor", "nano"), "--sensor = 'nano'; allowed is ati_nano17_si_12_0_12"),
        ((*MEASURED, "--clamp-position", "0,25"), "allowed is 3 numbers in m"),
        ((*MEASURED, "--wrench", "up"), "--wrench = 'up'; allowed is on_sensor, on_rod"),
        ((*MEASURED, "--layout", "forces=a"), "did you mean 'force'?"),
        ((*MEASURED, "--layout", "force"), "allowed is KEY=VALUE"),
        ((*MEASURED, "--layout", "force=a,b,c"), "force = 'a' is not in the file"),
    ],
)
def test_what_is_missing_or_wrong_is_one_line(
    more: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a terminal nothing is asked, and nothing is written."""
    refused = vibrissa(capsys, "init", BENCH / "ball_1.csv", "-o", tmp_path / "x.toml", *more)
    assert refused.status == 2 and said in refused.err
    assert len(refused.err.splitlines()) == 1 and not (tmp_path / "x.toml").exists()


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    there = tmp_path / "setup.toml"
    there.write_text("mine")
    refused = vibrissa(capsys, "init", BENCH / "ball_1.csv", "-o", there, *MEASURED)
    assert refused.status == 2 and "exists already" in refused.err
    assert there.read_text() == "mine"


def test_two_sets_of_columns_are_never_guessed(
    raw: RawRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, setup = units_below(raw, tmp_path), tmp_path / "setup.toml"
    table = pd.read_csv(log, skiprows=[1])
    for axis in "xyz":
        table[f"F_{axis}_raw"] = table[f"F_{axis}"] + 3.0
    table.to_csv(log, index=False)
    refused = vibrissa(capsys, "init", log, "-o", setup, *MEASURED)
    assert refused.status == 2
    assert "force may be that of F_x, F_y, F_z or of F_x_raw, F_y_raw, F_z_raw" in refused.err
    assert "allowed is --layout force=NAMES, names separated by commas" in refused.err


UNUSABLE: dict[str, tuple[Callable[[RawRecording], RawRecording], str]] = {
    "descending": (
        lambda raw: rows_of(raw, slice(None, None, -1)),
        "no stamp is later than the one before; allowed are increasing stamps",
    ),
    "three rows": (
        lambda raw: rows_of(raw, slice(3)),
        "is too short, or begins in contact or under a changing load",
    ),
    "begins in contact": (
        lambda raw: rows_of(raw, raw.time > 4.0),
        "allowed is a log that begins at rest and free of contact; no setup is written",
    ),
    "no readings": (
        lambda raw: raw.with_wrench(np.full((len(raw.time), 6), np.nan)),
        "no row holds readings",
    ),
}


@pytest.mark.parametrize("what", UNUSABLE)
def test_an_unusable_log_gives_no_setup(
    what: str, raw: RawRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would be one that `inspect` refuses, even if the sign is given."""
    damage, said = UNUSABLE[what]
    log, setup = vb.io.write_recording(tmp_path / "log.csv", damage(raw)), tmp_path / "setup.toml"
    refused = vibrissa(capsys, "init", log, "-o", setup, *MEASURED, "--wrench", "on_sensor")
    assert refused.status == 2 and said in refused.err and not setup.exists()
    assert refused.err.startswith(f"vibrissa: error: {log}: ")
    assert len(refused.err.splitlines()) == 1


def test_unusable_rows_are_counted(
    raw: RawRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrench = raw.wrench.copy()
    wrench[100:103] = np.nan
    for held, said in ((raw, "813 rows, time"), (raw.with_wrench(wrench), "810 usable, time")):
        log = vb.io.write_recording(tmp_path / "log.csv", held)
        run = vibrissa(capsys, "init", log, "-o", tmp_path / f"{said[:3]}.toml", *MEASURED)
        assert run.status == 0 and said in run.out


def test_a_name_that_occurs_twice_is_said_at_once(
    raw: RawRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = vb.io.write_recording(tmp_path / "log.csv", raw)
    log.write_text(log.read_text().replace("fx,fy,fz", "fx,fx,fz", 1))
    refused = vibrissa(capsys, "init", log, "-o", tmp_path / "x.toml", *MEASURED)
    assert refused.status == 2
    assert "log.csv, line 1: column 'fx' occurs 2 times; allowed is once" in refused.err


def test_columns_without_a_known_name_are_listed_and_placed_by_options(
    raw: RawRecording,
    truth: vb.Reactions,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Even if no name of the log is known."""
    log, setup = tmp_path / "log.csv", tmp_path / "setup.toml"
    numbers = np.column_stack([raw.time, raw.wrench, raw.position, raw.orientation])
    names = [f"ch{number}" for number in range(14)]
    np.savetxt(log, numbers, delimiter=";", comments="", header="# rig\n" + ";".join(names))
    table = {"time": 1, "force": 3, "torque": 3, "position": 3, "orientation": 4}
    given, left = [], names
    for quantity, count in table.items():
        if quantity in {"position", "orientation"}:
            refused = vibrissa(capsys, "init", log, "-o", setup, *MEASURED, *given)
            assert refused.status == 2 and not setup.exists()
            assert f"columns left over: {', '.join(left)}; allowed is --layout" in refused.err
            assert f"--layout {quantity}=NAMES" in refused.err
        given += ["--layout", f"{quantity}={','.join(left[:count])}"]
        left = left[count:]
    done = vibrissa(capsys, "init", log, "-o", setup, *MEASURED, *given)
    assert done.status == 0, done.err
    found = vb.read_recording(log, vb.load_setup(setup))
    np.testing.assert_allclose(found.force, truth.force, atol=1e-6)
    np.testing.assert_allclose(found.trail.position, truth.trail.position, atol=1e-8)


def test_a_linear_stage_states_by_numbers_what_does_not_change(
    raw: RawRecording,
    truth: vb.Reactions,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log, setup = tmp_path / "log.csv", tmp_path / "setup.toml"
    table = pd.DataFrame({"time": raw.time, "Stage [mm]": 1e3 * raw.position[:, 0]})
    table[["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]] = raw.wrench
    table.to_csv(log, index=False)
    turned = ",".join(map(str, raw.orientation[0]))
    given = [f"position=Stage [mm],{1e3 * raw.position[0, 1]},-25", f"orientation={turned}"]
    options = [part for one in given for part in ("--layout", one)]
    done = vibrissa(capsys, "init", log, "-o", setup, *MEASURED, *options)
    assert done.status == 0, done.err
    found = vb.read_recording(log, vb.load_setup(setup))
    np.testing.assert_allclose(found.force, truth.force, atol=1e-6)
    np.testing.assert_allclose(found.trail.axis, truth.trail.axis, atol=1e-12)
    np.testing.assert_allclose(found.trail.position, truth.trail.position, atol=1e-4)


def test_a_number_is_a_name_where_columns_are_numbered(raw: RawRecording, tmp_path: Path) -> None:
    """A column that is not there does not become a sensor that stands still."""
    log, setup = tmp_path / "log.csv", tmp_path / "setup.toml"
    numbers = np.column_stack([raw.time, raw.wrench, raw.position, raw.orientation])
    np.savetxt(log, numbers, delimiter=",", comments="", header=",".join(map(str, range(14))))
    names = {"time": [0], "force": [1, 2, 3], "torque": [4, 5, 6], "position": [7, 8, 99]}
    keys = [f"{key} = {list(map(str, own))}" for key, own in names.items()]
    keys += ["orientation = ['10', '11', '12', '13']", "orientation_form = 'xyzw'"]
    text = (BENCH / "setup.toml").read_text().partition("[recording]")[0]
    setup.write_text(text + "[recording]\n" + "\n".join(keys))
    with pytest.raises(vb.io.InputError, match="position = '99' is not in the file"):
        vb.read_recording(log, vb.load_setup(setup))


class Terminal(io.StringIO):
    """A terminal at which answers are typed, one a line."""

    def isatty(self) -> bool:
        """It is one."""
        return True


def test_at_a_terminal_it_asks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Columns are confirmed with a return, a wrong answer is asked for again."""
    answers = ["", "", "", "", "", "5 cats", "50 mm", "0.25 mm", "206 GPa", "0,0,25mm", "", ""]
    monkeypatch.setattr(sys, "stdin", Terminal("\n".join(answers) + "\n"))
    setup = tmp_path / "setup.toml"
    done = vibrissa(
        capsys, "init", BENCH / "ball_1.csv", "-o", setup, "--layout", "pose_file=ball_1_robot.csv"
    )
    assert done.status == 0, done.err
    said = done.out + done.err
    assert "the columns of force" in said and "[Fx (N),Fy (N),Fz (N)]" in said
    assert "--length = '5 cats'; allowed is a number in m" in said
    loaded = vb.load_setup(setup)
    assert loaded.rod.length == 0.05 and loaded.sensor.wrench == "on_sensor"
    assert loaded.recording is not None and loaded.recording.time_unit == "ms"


@pytest.mark.parametrize(
    ("header", "orientation"),
    [
        ("t,x,y,z,W,P,R,fx,fy,fz,tx,ty,tz", ("W", "P", "R")),
        ("t,TcpX,TcpY,TcpZ,Roll,Pitch,Yaw,Fx,Fy,Fz,Mx,My,Mz", ("Roll", "Pitch", "Yaw")),
        (
            "stamp.sec,stamp.nanosec,force.x,force.y,force.z,torque.x,torque.y,torque.z,"
            "position.x,position.y,position.z,"
            "orientation.x,orientation.y,orientation.z,orientation.w",
            ("orientation.x", "orientation.y", "orientation.z", "orientation.w"),
        ),
        (
            "Temps,Force X,Force Y,Force Z,Couple X,Couple Y,Couple Z,X,Y,Z,qw,qx,qy,qz",
            ("qx", "qy", "qz", "qw"),
        ),
    ],
)
def test_names(header: str, orientation: tuple[str, ...]) -> None:
    """One set of columns for each quantity."""
    found = groups(header.split(","))
    assert {key: len(sets) for key, sets in found.items()} == dict.fromkeys(found, 1)
    assert found["orientation"][0].names == orientation
    assert [len(found[key][0].names) for key in ("force", "torque", "position")] == [3, 3, 3]
