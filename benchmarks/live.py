"""The live stream against the simulated sensor, on the loopback address: `python benchmarks/live.py
[losses|kills] ...`. The README explains the output.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

RUNS = ((1000, 60, False), (7000, 10, False), (7000, 10, True))
"""Records per second, seconds, whether the sensor sends several records per datagram."""
KILLS = 20
ALLOWED = 0.1

CASE = """\
[rod]
kind = "cylinder"
length = 0.05
radius = 0.25e-3
youngs_modulus = 206e9

[object]
kind = "sphere"
center = [0.0, 0.0, 0.0575]
radius = 0.03

[[trail]]
kind = "line"
start = [0.04, 0.005, 0.0]
stop = [-0.05, 0.005, 0.0]
count = 321
"""
SETUP = """\
[rod]
kind = "cylinder"
length = 0.05
radius = 0.25e-3
youngs_modulus = 206e9

[sensor]
clamp_position = [0.0, 0.0, 0.025]
clamp_orientation = [0.0, 0.0, 0.0, 1.0]
wrench = "on_sensor"
tare_seconds = 0.9
force_noise = 2.0e-3
torque_noise = 4.0e-5
force_resolution = 1.5625e-3
torque_resolution = 7.8125e-6
position_noise = 1.0e-5

[rdt]
counts_per_force = 1.0e6
counts_per_torque = 1.0e6
rate = {rate}
buffered = {buffered}

[pose]
kind = "case"
path = "case.toml"
rest = 1.0
sweep = {sweep}
"""


def vibrissa(*arguments: object, core: int) -> list[str]:
    """Command line of a process on one core."""
    program = "import sys; from vibrissa.cli import main; sys.argv[0] = 'vibrissa'; main()"
    pin = f"import os; os.sched_setaffinity(0, {{{core}}}); "
    return [sys.executable, "-c", pin + program, *map(str, arguments)]


@contextmanager
def sensor(folder: Path, core: int, *options: object) -> Iterator[int]:
    """Run a simulated sensor and give its port."""
    command = vibrissa(
        "simulate-sensor",
        folder / "case.toml",
        "--setup",
        folder / "setup.toml",
        "--port",
        0,
        "--rest",
        1.0,
        "--json",
        *options,
        core=core,
    )
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield int(_line(process, "listening").split(":")[1].split(",")[0])
    finally:
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=20)
        print("    sensor:", " ".join(out.split()))


def _line(process: subprocess.Popen[str], begins: str) -> str:
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(begins):
            return line
    raise RuntimeError(f"the process ended before {begins!r}")


def cores() -> tuple[int, int]:
    """Cores for the sensor and for the stream; the same if there is only one."""
    allowed = sorted(os.sched_getaffinity(0))
    return allowed[0], allowed[-1]


def losses(folder: Path, rate: int, seconds: int, *, buffered: bool) -> dict[str, object]:
    """Stream for this long; the summary of `vibrissa live`."""
    (folder / "setup.toml").write_text(
        SETUP.format(rate=float(rate), buffered=str(buffered).lower(), sweep=float(seconds)),
        encoding="utf-8",
    )
    first, last = cores()
    file = folder / f"{rate}_{seconds}_{buffered}.mcap"
    with sensor(folder, first, "--sweep", seconds, "--seed", 1) as port:
        command = vibrissa(
            "live",
            "--source",
            f"netft://127.0.0.1:{port}",
            "--setup",
            folder / "setup.toml",
            "--sink",
            file,
            "--duration",
            seconds,
            "--json",
            core=last,
        )
        result = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(result.stdout) | {"wrenches in the file": len(wrench_stamps(file)[0])}


def wrench_stamps(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [ns] and numbers of all wrenches in a file, read with `mcap`; `rosbags` has to find
    the same messages.
    """
    from mcap.reader import make_reader  # noqa: PLC0415
    from rosbags.highlevel import AnyReader  # noqa: PLC0415

    with file.open("rb") as stream:
        mcap = [
            (channel.topic, message.log_time, message.data, message.sequence)
            for _, channel, message in make_reader(stream).iter_messages()
        ]
    with AnyReader([file]) as reader:
        bag = [
            (connection.topic, moment, bytes(data))
            for connection, moment, data in reader.messages()
        ]
    assert [row[:3] for row in mcap] == bag, "the two readers differ"
    wrenches = [row for row in mcap if row[0] == "/vibrissa/wrench"]
    stamps = [
        int.from_bytes(row[2][4:8], "little") * 10**9 + int.from_bytes(row[2][8:12], "little")
        for row in wrenches
    ]
    return np.array(stamps, dtype=np.int64), np.array([row[3] for row in wrenches], dtype=np.int64)


def kills(folder: Path, count: int) -> list[dict[str, object]]:
    """Kill the stream at random moments, and look at what its files hold."""
    (folder / "setup.toml").write_text(
        SETUP.format(rate=1000.0, buffered="false", sweep=5.0), encoding="utf-8"
    )
    first, last = cores()
    chance = random.Random(1)
    rows = []
    for number in range(count):
        file = folder / f"killed_{number}.mcap"
        with sensor(folder, first, "--sweep", 5, "--repeat", "--seed", number) as port:
            command = vibrissa(
                "live",
                "--source",
                f"netft://127.0.0.1:{port}",
                "--setup",
                folder / "setup.toml",
                "--sink",
                file,
                core=last,
            )
            process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
            _line(process, "first sample")
            time.sleep(chance.uniform(0.2, 6.0))
            killed = time.time_ns()
            process.kill()
            process.wait()
        stamps, numbers = wrench_stamps(file)
        missing = (killed - int(stamps[-1])) * 1e-9
        gaps = int(np.count_nonzero(np.diff(numbers) != 1))
        rows.append({"wrenches": len(stamps), "missing": missing, "gaps": gaps})
        print(
            f"    {number + 1}: {len(stamps)} wrenches, the last {missing * 1e3:.1f} ms before the kill, {gaps} gaps; opened by mcap and rosbags"
        )
    return rows


def main(which: list[str]) -> None:
    """Print what was measured."""
    sensor_core, stream_core = cores()
    print(
        f"sensor on core {sensor_core}, stream on core {stream_core}; load of the machine before: {os.getloadavg()[0]:.1f}"
    )
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "case.toml").write_text(CASE, encoding="utf-8")
        for rate, seconds, buffered in RUNS if "losses" in which else ():
            print(
                f"{rate} records a second for {seconds} s, {'several' if buffered else 'one'} a datagram"
            )
            report = losses(folder, rate, seconds, buffered=buffered)
            counts = report["counts"]
            assert isinstance(counts, dict)
            print(
                f"    samples {counts['samples']}, lost {counts['lost']}, thrown away {report['overflow']}, in the file {report['wrenches in the file']}"
            )
            median, high = (
                float(str(report[key])) * 1e3 for key in ("latency_median", "latency_999")
            )
            print(
                f"    latency median {median:.2f} ms, 99.9th percentile {high:.2f} ms; CPU share {float(str(report['cpu_share'])):.1%} of one core"
            )
        if "kills" in which:
            print(f"killed {KILLS} times at random moments")
            rows = kills(folder, KILLS)
            good = [row for row in rows if float(str(row["missing"])) <= ALLOWED]
            print(f"    {len(good)} of {len(rows)} hold all but the last {ALLOWED} s")


if __name__ == "__main__":
    main(sys.argv[1:] or ["losses", "kills"])
