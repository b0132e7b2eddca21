"""`vibrissa live` and `vibrissa simulate-sensor`: what they refuse, and what they leave behind."""

import json
import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData

from vibrissa.files import InputError
from vibrissa.live.address import Address, parse_address

EXAMPLES = Path(__file__).parents[2] / "examples"
SETUP = EXAMPLES / "recordings/sphere_60mm/setup.toml"
TRAIL = EXAMPLES / "recordings/sphere_60mm/trail.csv"
CASE = EXAMPLES / "cases/steel_wire_sphere.toml"


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    from vibrissa.cli.app import main

    monkeypatch.setattr(sys, "argv", ["vibrissa", *map(str, arguments)])
    monkeypatch.setattr(os, "environ", dict(os.environ))
    with pytest.raises(SystemExit) as stopped:
        main()
    return int(stopped.value.code or 0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("netft://127.0.0.1:49152", Address("netft", "127.0.0.1", 49152)),
        ("netft://sensor.lab", Address("netft", "sensor.lab", 49152)),
        ("netft://[::1]:7", Address("netft", "::1", 7)),
        ("tcp://localhost:5000", Address("tcp", "localhost", 5000)),
        ("serial:/dev/ttyUSB0", Address("serial", "/dev/ttyUSB0")),
        ("serial:/dev/ttyUSB0?baud=921600", Address("serial", "/dev/ttyUSB0", baud=921600)),
        ("replay:a b.csv", Address("replay", "a b.csv")),
        ("replay:/x/y.csv?speed=10", Address("replay", "/x/y.csv", speed=10.0)),
        ("replay:/x/what?.csv?speed=max", Address("replay", "/x/what?.csv", speed=float("inf"))),
    ],
)
def test_addresses(text: str, expected: Address) -> None:
    assert parse_address(text) == expected


WRONG_ADDRESSES = [
    "",
    "netft",
    "netft://",
    "netft://host:0",
    "netft://host:99999",
    "netft://host:port",
    "netft://host:1/path",
    "netft://user@host:1",
    "netft://host:1?rate=5",
    "tcp://host",
    "tcp://[::1",
    "serial:",
    "serial:/dev/x?baud=fast",
    "serial:/dev/x?baud=0",
    "serial:/dev/x?parity=odd",
    "replay:",
    "replay:x.csv?speed=0",
    "replay:x.csv?speed=nan",
    "replay:x.csv?speed=-1",
    "udp://host:1",
]


@pytest.mark.parametrize("text", WRONG_ADDRESSES)
def test_addresses_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="allowed"):
        parse_address(text)


REPLAY = f"replay:{TRAIL}?speed=max"
LIVE = ("live", "--source", REPLAY, "--setup", SETUP)
SIMULATE = ("simulate-sensor", CASE, "--setup", SETUP)
REFUSED = {
    "no source": (("live", "--source", "nowhere", "--setup", SETUP), ["nowhere", "netft://"]),
    "no such file": (
        ("live", "--source", "replay:none.csv", "--setup", SETUP),
        ["none.csv", "cannot be read"],
    ),
    "no such setup": ((*LIVE[:4], "none.toml"), ["none.toml", "cannot be read"]),
    "another sink": ((*LIVE, "--sink", "x.bag"), ["x.bag", "FILE.mcap"]),
    "no sink": ((*LIVE, "--sink", "jsonl:"), ["jsonl:"]),
    "a sink that is there": ((*LIVE, "--sink", "there.mcap"), ["there.mcap", "--overwrite"]),
    "a folder that holds something": ((*LIVE, "--sink", "rosbag2:."), ["sink .", "--overwrite"]),
    "no folder": ((*LIVE, "--sink", "rosbag2:there.mcap"), ["there.mcap", "folder"]),
    "one file twice": (
        (*LIVE, "--sink", "x.jsonl", "--sink", "jsonl:./x.jsonl"),
        ["x.jsonl", "twice"],
    ),
    "no time": ((*LIVE, "--duration", "0"), ["--duration", "0"]),
    "no batch": ((*LIVE, "--batch", "nan"), ["--batch", "nan"]),
    "negative silence": ((*LIVE, "--silence", "-1"), ["--silence", "-1"]),
    "negative friction": ((*LIVE, "--friction", "-1"), ["--friction", "-1"]),
    "no case": (("simulate-sensor", "none.toml", "--setup", SETUP), ["none.toml"]),
    "no rate": ((*SIMULATE, "--rate", "-5"), ["rate", "-5"]),
    "half a tare": ((*SIMULATE, "--tare", "1,2,3"), ["tare", "1,2,3", "six"]),
    "more than all": ((*SIMULATE, "--drop", "1.5"), ["drop", "1.5"]),
    "no port": ((*SIMULATE, "--port", "70000"), ["port", "70000"]),
    "no address for poses": ((*SIMULATE, "--pose", "here"), ["here", "HOST:PORT"]),
    "no sweep": ((*SIMULATE, "--sweep", "0"), ["sweep", "0"]),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything slow begins: nothing is scanned, nothing compiled."""
    arguments, words = REFUSED[name]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.mcap").write_bytes(b"something")
    assert run(monkeypatch, *arguments) == 2
    out, err = capsys.readouterr()
    lines = [line for line in err.splitlines() if line.startswith("vibrissa: error:")]
    assert out == ""
    assert len(lines) == 1
    assert "Traceback" not in err
    assert [word for word in [*words, "allowed"] if word not in lines[0]] == []
    assert (tmp_path / "there.mcap").read_bytes() == b"something"


TABLES = {
    "counts": (
        "[rdt]\ncounts_per_force = 0\ncounts_per_torque = 1\nrate = 1\n",
        ["rdt.counts_per_force", "0", "greater than 0"],
    ),
    "no rate": ("[rdt]\ncounts_per_force = 1\ncounts_per_torque = 1\n", ["rdt.rate", "missing"]),
    "unknown": (
        "[rdt]\ncounts_per_force = 1\ncounts_per_torque = 1\nrate = 1\nspeed = 2\n",
        ["rdt.speed", "unknown"],
    ),
    "bits": (
        "[rdt]\ncounts_per_force = 1\ncounts_per_torque = 1\nrate = 1\nerror_bits = 0x100000000\n",
        ["rdt.error_bits", "32 bits"],
    ),
    "kind": ('[pose]\nkind = "robot"\n', ["pose.kind", "robot", "constant, udp, trail or case"]),
    "address": (
        '[pose]\nkind = "udp"\nlisten = "tcp://127.0.0.1:1"\n',
        ["pose.listen", "udp://HOST:PORT"],
    ),
    "quaternion": (
        '[pose]\nkind = "constant"\norientation = [0.0, 0.0, 0.0, 0.0]\n',
        ["orientation", "non-zero norm"],
    ),
    "motion": ('[pose]\nkind = "trail"\npath = "none.csv"\n', ["none.csv", "cannot be read"]),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_that_are_wrong(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text, words = TABLES[name]
    setup = tmp_path / "setup.toml"
    setup.write_text(SETUP.read_text(encoding="utf-8") + "\n" + text, encoding="utf-8")
    assert run(monkeypatch, "live", "--source", "netft://127.0.0.1:9", "--setup", setup) == 2
    err = capsys.readouterr().err
    assert [word for word in [*words, "allowed"] if word not in err] == []


def test_a_sensor_is_simulated_whose_setup_leaves_its_rest_to_be_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without `tare_seconds` all is read and checked as with it, up to what is wrong."""
    setup = tmp_path / "setup.toml"
    setup.write_text(SETUP.read_text(encoding="utf-8").replace("tare_seconds", "# tare_seconds"))
    assert run(monkeypatch, "simulate-sensor", CASE, "--setup", setup, "--sweep", "0") == 2
    assert "sweep = 0" in capsys.readouterr().err


def test_work_that_fails_has_status_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Nobody at the port; a serial device that is none; a recording too short for its tare."""
    short = tmp_path / "short.csv"
    short.write_text(
        "".join(TRAIL.read_text(encoding="utf-8").splitlines(keepends=True)[:2]), encoding="utf-8"
    )
    for source, word in (
        ("tcp://127.0.0.1:9", "refused"),
        ("serial:/dev/null/none", "/dev/null/none"),
    ):
        assert run(monkeypatch, "live", "--source", source, "--setup", SETUP) == 1
        out, err = capsys.readouterr()
        assert out == ""
        assert word in err.splitlines()[-1]
    assert run(monkeypatch, "live", "--source", f"replay:{short}", "--setup", SETUP) == 2
    assert "tare_seconds = 0.9: 1 of 1 samples lie within it" in capsys.readouterr().err


def test_json_lines_on_standard_output(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Only rows there; the summary goes to stderr."""
    assert run(monkeypatch, *LIVE, "--sink", "jsonl:-", "--json") == 0
    out, err = capfd.readouterr()
    rows = [json.loads(line) for line in out.splitlines()]
    summary = json.loads(err[err.index("{") :])
    assert len(rows) == summary["rows"] == summary["counts"]["samples"] == 901
    assert sum(row["kind"] == "TIP" for row in rows) == summary["contacts"]["TIP"]


def test_asked_to_end_it_writes_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """SIGTERM in the middle of a replay: PLY and JSON lines hold the same contacts, and the status
    is 0.
    """
    cloud, lines = tmp_path / "x.ply", tmp_path / "x.jsonl"
    before = signal.getsignal(signal.SIGTERM)

    def end() -> None:
        until = time.monotonic() + 120
        while time.monotonic() < until and (
            not lines.exists() or lines.read_text(encoding="utf-8").count("TIP") < 20
        ):
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=end)
    thread.start()
    status = run(
        monkeypatch,
        "live",
        "--source",
        f"replay:{TRAIL}?speed=5",
        "--setup",
        SETUP,
        "--sink",
        cloud,
        "--sink",
        lines,
    )
    thread.join()
    assert status == 0
    assert "CPU share" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) is before
    rows = [json.loads(line) for line in lines.read_text(encoding="utf-8").splitlines()]
    points = np.array([row["point"] for row in rows if row["point"]])
    vertices = PlyData.read(cloud)["vertex"]
    assert 20 <= len(points) < 600
    assert len(rows) < 901
    np.testing.assert_array_equal(np.column_stack([vertices[axis] for axis in "xyz"]), points)
