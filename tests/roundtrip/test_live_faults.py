"""What goes wrong with a stream is said and counted, and leaves whole files: silences, takeovers,
restarts with another zero, full disks, ports in use.
"""

import json
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData
from rosbags.highlevel import AnyReader

import vibrissa as vb
from vibrissa.io.recordings.read import read_cleaned
from vibrissa.io.rosbag import McapSink, Rosbag2Sink
from vibrissa.io.sinks import JsonLinesSink, PlySink
from vibrissa.live import (
    ConstantPose,
    NetFtSource,
    Processor,
    ReplaySource,
    Samples,
    SensorSimulator,
    Sink,
    stream,
)
from vibrissa.live.report import Report, SilenceWatch
from vibrissa.sensor import RawRecording

FOLDER = Path(__file__).parents[2] / "examples/recordings/sphere_60mm"
COUNTS = {"counts_per_force": 1e6, "counts_per_torque": 1e6}
COLUMNS = ("position", "orientation", "force", "torque")


@pytest.fixture(scope="module")
def setup() -> vb.Setup:
    return vb.load_setup(FOLDER / "setup.toml")


@pytest.fixture(scope="module")
def raw(setup: vb.Setup) -> RawRecording:
    return read_cleaned(FOLDER / "trail.csv", setup)


def restarted(raw: RawRecording, row: int, shift: np.ndarray) -> Samples:
    """The recording up to a row, where the sensor is restarted with another zero; two seconds later
    the whole recording again.
    """
    first, count = slice(0, row), len(raw.time)
    columns = {
        name: np.concatenate([getattr(raw, name)[first], getattr(raw, name)]) for name in COLUMNS
    }
    columns["force"][row:] += shift[:3]
    columns["torque"][row:] += shift[3:]
    stamp = np.round(
        np.concatenate([raw.time[first], raw.time + raw.time[row - 1] + 2]) * 1e9
    ).astype(np.int64)
    anew = np.arange(row + count) == row
    force, torque = columns["force"], columns["torque"]
    good = np.ones(len(stamp), dtype=bool)
    return Samples(
        stamp,
        np.arange(len(stamp)),
        force,
        torque,
        good,
        stamp,
        columns["position"],
        columns["orientation"],
        anew,
    )


def through(processor: Processor, samples: Samples) -> tuple[dict[str, np.ndarray], list[str]]:
    """Kind, status and point of all rows, and what was said."""
    found: list[vb.Reconstruction] = []
    news: list[str] = []
    processor.report.notice = news.append
    for first in range(0, len(samples), 50):
        processor.push(samples[first : first + 50])
        found += [result.found for result in processor.ready(int(samples.stamp[-1]))]
    return {
        name: np.concatenate([getattr(part, name) for part in found])
        for name in ("kind", "status", "point")
    }, news


@pytest.mark.parametrize(("row", "offset"), [(901, 0.0), (901, 0.3), (450, 0.3)])
def test_the_zero_of_a_restarted_sensor(
    setup: vb.Setup, raw: RawRecording, row: int, offset: float
) -> None:
    """The same or another, restarted free or in the midst of a contact: once the zero is known,
    contacts lie on the ball as before, and none that says OK is off it.
    """
    processor = Processor(setup.rod, setup.sensor, ConstantPose())
    found, news = through(
        processor, restarted(raw, row, np.array([1, -1, 1, 0.01, 0.01, -0.01]) * offset)
    )
    assert [line.startswith("warning: ") for line in news if "restart" in line] == [offset > 0]
    assert processor.report.zero_changes == (offset > 0)
    after = found["status"][row:]
    assert 0 < processor.report.unsure < 120
    assert np.all(after[: processor.report.unsure] != vb.Status.OK)
    assert np.count_nonzero(after[processor.report.unsure :] == vb.Status.OK) > 700
    assert setup.surface is not None
    sound = (found["kind"] > 0) & (found["status"] == vb.Status.OK)
    off = np.abs(setup.surface.distances(found["point"][sound]))
    second = np.flatnonzero(sound) >= row
    assert np.median(off[second]) < 2e-4
    assert np.count_nonzero(second) > 500


def test_a_zero_that_a_contact_may_hide_stays_unknown(setup: vb.Setup, raw: RawRecording) -> None:
    """Restarted with another zero where the sensor stands in contact, and never free again: every
    row says that it is not to be trusted.
    """
    rows = np.concatenate([np.arange(450), np.full(300, 450)])
    columns = {name: getattr(raw, name)[rows] for name in COLUMNS}
    columns["force"] = columns["force"] + (np.arange(750) >= 500)[:, None] * np.array(
        [0.2, 0.1, -0.3]
    )
    columns["force"] += np.random.default_rng(0).normal(size=(750, 3)) * 2e-3
    stamp = np.round(np.arange(750) * 1e7).astype(np.int64)
    samples = Samples(stamp, np.arange(750), columns["force"], columns["torque"], np.ones(750, dtype=bool), stamp,
                      columns["position"], columns["orientation"], np.arange(750) == 500)  # fmt: skip
    processor = Processor(setup.rod, setup.sensor, ConstantPose())
    found, _ = through(processor, samples)
    assert processor.report.zero_changes == 0
    assert np.all(found["status"][500:] != vb.Status.OK)
    assert np.any(found["status"][200:500] == vb.Status.OK)


def test_silences_are_counted_once_each() -> None:
    """At 1000 samples a second half a second is one; of a sensor with one sample a second, twenty
    are.
    """
    report, millisecond = Report(), 1_000_000
    watch = SilenceWatch(report)
    arrival = np.arange(1000) * millisecond
    assert watch.came(arrival) is None
    assert not watch.begins(int(arrival[-1]) + 400 * millisecond)
    assert watch.begins(int(arrival[-1]) + 600 * millisecond)
    assert not watch.begins(int(arrival[-1]) + 700 * millisecond)
    assert watch.came(arrival[-1:] + 900 * millisecond) == pytest.approx(0.9)
    assert (report.silences, report.silent_seconds) == (1, pytest.approx(0.9))
    slow = SilenceWatch(report)
    for second in range(30):
        assert not slow.begins(second * 1000 * millisecond)
        assert slow.came(np.array([second * 1000 * millisecond])) is None
    assert not slow.begins((29 + 19) * 1000 * millisecond)
    assert slow.begins((29 + 21) * 1000 * millisecond)


def test_a_stream_that_another_client_takes(setup: vb.Setup, raw: RawRecording) -> None:
    """Both ends say so: the simulator names the client, and the first client counts what it did not
    get.
    """
    still = np.zeros((512, 3))
    block = RawRecording(
        np.arange(512) / 1e3, still, np.tile([0.0, 0, 0, 1], (512, 1)), still, still
    )
    heard: list[str] = []
    simulator = SensorSimulator(iter([block] * 20), **COUNTS, rate=1e3, port=0, notice=heard.append)
    simulator.open()
    stop = threading.Event()
    threads = [threading.Thread(target=lambda: simulator.run(stop=stop))]
    second = NetFtSource("127.0.0.1", simulator.port, **COUNTS, rate=1e3)

    def take() -> None:
        time.sleep(0.6)
        second.open()

    threads.append(threading.Thread(target=take))
    processor = Processor(setup.rod, setup.sensor, ConstantPose())
    processor.warm_up()
    for thread in threads:
        thread.start()
    try:
        source = NetFtSource("127.0.0.1", simulator.port, **COUNTS, rate=1e3)
        report = stream(source, processor, [], silence=0, duration=2.5)
    finally:
        stop.set()
        for thread in threads:
            thread.join(10)
        second.close()
        simulator.close()
    assert simulator.sent.takeovers >= 2
    assert all("asked for the stream" in line for line in heard)
    assert report.silences >= 1
    assert report.silent_seconds > 0.5
    assert report.counts.restarts >= 1
    assert report.counts.lost > 500
    words = " ".join(report.warnings)
    assert [
        word
        for word in ("samples came again after", "clock restarted", "are lost")
        if word not in words
    ] == []


def full(monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    """A disk that has room for so many bytes in each file: writes beyond are short, then fail."""
    write, pwrite = os.write, os.pwrite

    def short_write(descriptor: int, data: bytes) -> int:
        left = room - os.fstat(descriptor).st_size
        if left <= 0:
            raise OSError(28, "No space left on device")
        return write(descriptor, bytes(data)[:left])

    def short_pwrite(descriptor: int, data: bytes, place: int) -> int:
        left = room - place
        if left <= 0:
            raise OSError(28, "No space left on device")
        return pwrite(descriptor, bytes(data)[:left], place)

    monkeypatch.setattr(os, "write", short_write)
    monkeypatch.setattr(os, "pwrite", short_pwrite)


def stopped_by(sink: Sink, setup: vb.Setup, raw: RawRecording) -> OSError:
    with pytest.raises(OSError, match="No space left") as caught:
        stream(
            ReplaySource(raw, np.inf), Processor(setup.rod, setup.sensor, ConstantPose()), [sink]
        )
    return caught.value


def test_a_full_disk_leaves_whole_files_and_is_named(
    tmp_path: Path, setup: vb.Setup, raw: RawRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines, cloud, bag, folder = (tmp_path / name for name in ("x.jsonl", "x.ply", "x.mcap", "bag"))
    with monkeypatch.context() as patched:
        full(patched, 20_001)
        for file, make in ((lines, JsonLinesSink), (cloud, PlySink)):
            assert stopped_by(make(file), setup, raw).filename == str(file)
        with pytest.raises(OSError, match="No space left") as caught:
            McapSink(bag)
        assert caught.value.filename == str(bag)
        with pytest.raises(OSError, match="No space left"):
            Rosbag2Sink(folder)
    written = lines.read_bytes()
    assert written.endswith(b"\n")
    assert 10 < len([json.loads(line) for line in written.splitlines()]) < 100
    assert 0 <= len(PlyData.read(cloud)["vertex"].data) < 300
    assert list(folder.iterdir()) == []
    assert sorted(tmp_path.iterdir()) == [folder, lines, cloud]
    with monkeypatch.context() as patched:
        sink, flushed = McapSink(bag), 0
        full(patched, 60_000)
        with pytest.raises(OSError, match=str(bag)):
            for first in range(0, 900, 100):
                rows = slice(first, first + 100)
                sink.wrench(
                    np.arange(first, first + 100), np.arange(100), raw.force[rows], raw.torque[rows]
                )
                sink.flush()
                flushed += 100
    for after in (sink.close, lambda: None):  # there is room again
        with AnyReader([bag]) as reader:
            assert len(list(reader.messages())) == flushed > 0
        after()


@pytest.fixture
def taken() -> Iterator[int]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        yield int(other.getsockname()[1])


def test_a_port_in_use_is_named_and_nothing_is_left(
    tmp_path: Path, taken: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from vibrissa.cli.app import main

    setup, bag = tmp_path / "setup.toml", tmp_path / "bag"
    table = f'\n[pose]\nkind = "udp"\nlisten = "udp://127.0.0.1:{taken}"\n'
    setup.write_text((FOLDER / "setup.toml").read_text(encoding="utf-8") + table, encoding="utf-8")
    case = FOLDER.parents[1] / "cases/steel_wire_sphere.toml"
    live = (
        "live",
        "--source",
        "netft://127.0.0.1:9",
        "--setup",
        setup,
        "--sink",
        f"rosbag2:{bag}",
        "--sink",
        tmp_path / "x.jsonl",
    )
    for command in (live, live, ("simulate-sensor", case, "--setup", setup, "--port", taken)):
        monkeypatch.setattr(sys, "argv", ["vibrissa", *map(str, command)])
        monkeypatch.setattr(os, "environ", dict(os.environ))
        with pytest.raises(SystemExit) as stopped:
            main()
        assert stopped.value.code == 1
        last = capsys.readouterr().err.splitlines()[-1]
        assert last == f"vibrissa: error: udp://127.0.0.1:{taken}: Address already in use"
    assert not bag.exists() or list(bag.iterdir()) == []
    assert not (tmp_path / "x.jsonl").exists()
