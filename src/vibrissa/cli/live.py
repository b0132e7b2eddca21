"""`vibrissa live`: from a sensor's stream to contacts, as it comes."""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.live_parts import poses_of, rdt_of, say, working
from vibrissa.cli.view import opened, until_interrupt

if TYPE_CHECKING:
    from vibrissa.viewer import ViewerSink

SINKS = "FILE.mcap, rosbag2:FOLDER, FILE.ply, FILE.jsonl, jsonl:FILE and jsonl:- (standard output)"


def live(
    source: Annotated[
        str,
        typer.Option(
            help="netft://HOST[:PORT], tcp://HOST:PORT, serial:DEVICE[?baud=N] or "
            "replay:FILE[?speed=X]."
        ),
    ],
    setup: Annotated[
        Path,
        typer.Option(help="TOML file with [rod], [sensor] and, for a sensor, [rdt] and [pose]."),
    ],
    sink: Annotated[list[str] | None, typer.Option(help=f"{SINKS}; repeatable.")] = None,
    duration: Annotated[
        float | None,
        typer.Option(help="Seconds to run after the first sample.", callback=common.positive),
    ] = None,
    batch: Annotated[
        float,
        typer.Option(help="Seconds of samples to process together.", callback=common.positive),
    ] = 0.005,
    silence: Annotated[
        float,
        typer.Option(
            help="Seconds without a sample after which to give up; 0 for never.",
            callback=common.not_negative,
        ),
    ] = 5.0,
    friction: common.Friction = None,
    smooth: Annotated[
        bool,
        typer.Option(
            "--smooth", help="Smooth the contacts as they come: each from all samples up to it."
        ),
    ] = False,
    see: common.View = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print the summary as JSON; to stderr if a sink takes stdout."),
    ] = False,
) -> None:
    """Reconstruct contacts from a running sensor, and record them and the raw wrench. Ends with the
    source, after --duration, or on an interrupt.
    """
    # Batches are small: the CPU with synchronous dispatch answers soonest.
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    os.environ.setdefault("JAX_CPU_ENABLE_ASYNC_DISPATCH", "false")
    say("loading")
    address = vb.live.parse_address(source)
    targets = [_target(text, overwrite=overwrite) for text in sink or []]
    places = [path and path.resolve() for _, path in targets]
    for place in places:
        if places.count(place) > 1:
            raise vb.io.InputError(
                f"sink {place or 'jsonl:-'}: is given twice; allowed is one sink for each file"
            )
    loaded = vb.load_setup(setup)
    if smooth and loaded.sensor.force_noise is None:
        raise vb.io.InputError(
            "sensor.force_noise is not given with --smooth; allowed is a setup with force_noise "
            "and torque_noise"
        )
    origin = _source(address, loaded)
    processor = vb.live.Processor(
        loaded.rod,
        loaded.sensor,
        poses_of(loaded, setup.parent, needed=address.kind == "netft"),
        stage=vb.live.SmoothingStage(loaded.rod, friction=friction) if smooth else None,
        friction=friction,
        tolerances=loaded.parameter_covariance,
    )
    with opened() if see else nullcontext():
        viewer = _viewer(loaded) if see else None
    with working() as stop:
        makers: list[tuple[Callable[[Any], vb.live.Sink], Any]]
        makers = [(_maker(kind, loaded), path) for kind, path in targets]
        if viewer is not None:
            makers.append((lambda _: viewer, None))
        processor.warm_up()
        # No collection of garbage among what was made so far, and short turns: the reading thread
        # must not wait for the working one.
        gc.collect()
        gc.freeze()
        sys.setswitchinterval(1e-3)
        report = vb.live.stream(
            origin,
            processor,
            # One by one: those already made are closed if the next cannot be.
            lambda: (make(path) for make, path in makers),
            duration=duration,
            batch_seconds=batch,
            silence=silence,
            stop=stop,
            notice=say,
        )
    count, sound = sum(report.statuses.values()), report.statuses.get("OK", 0)
    if report.rows:
        causes = [*common.contradictions, *report.warnings]
        common.doubt(
            count, sound, report.statuses, causes, "the loads never exceed the noise, or the rod "
            "was not free during the tare",
        )  # fmt: skip
    else:
        common.warn("no row was processed: no samples came, or no tare or no poses")
    last = common.contacts_line(count, sound) + common.into(*filter(None, (p for _, p in targets)))
    if as_json:
        typer.echo(json.dumps(asdict(report), indent=1), err=None in places)
    else:
        say(f"{_text(report)}\n{last}")
    if viewer is not None:
        # An interrupt that ended the stream ends the page, too.
        if not stop.is_set():
            until_interrupt()
        viewer.end()
    if report.silent:
        raise typer.Exit(1)


def _viewer(loaded: vb.Setup) -> ViewerSink:
    from vibrissa.viewer import ViewerSink  # noqa: PLC0415

    sink = ViewerSink(loaded.rod, loaded.surface)
    say(f"view: {sink.url}")
    return sink


def _source(address: vb.live.Address, loaded: vb.Setup) -> vb.live.Source:
    from vibrissa.io.recordings.read import read_cleaned  # noqa: PLC0415
    from vibrissa.io.setup import UdpPoseTable  # noqa: PLC0415
    from vibrissa.live.lines import serial_line, tcp_line  # noqa: PLC0415

    if address.kind == "replay":
        return vb.live.ReplaySource(read_cleaned(address.path, loaded), address.speed)
    if address.kind == "netft":
        return vb.live.NetFtSource(address.path, address.port, **rdt_of(loaded).model_dump())
    tcp = address.kind == "tcp"
    line = tcp_line(address.path, address.port) if tcp else serial_line(address.path, address.baud)
    return vb.live.LineSource(line, on_host_clock=isinstance(loaded.pose, UdpPoseTable))


def _target(text: str, *, overwrite: bool) -> tuple[str, Path | None]:
    """Kind of a sink, and its file or folder."""
    from vibrissa.files import writable, writable_folder  # noqa: PLC0415

    if text == "jsonl:-":
        return "jsonl", None
    kind, _, name = text.partition(":")
    if kind not in ("jsonl", "rosbag2"):
        kind, name = Path(text).suffix.lower()[1:], text
    path, folder = Path(name), kind == "rosbag2"
    if kind not in ("mcap", "ply", "jsonl", "rosbag2") or not (name if folder else path.name):
        raise vb.io.InputError(f"sink {text!r}; allowed are {SINKS}")
    there = any(path.iterdir()) if folder and path.is_dir() else path.is_file()
    if there and not (overwrite and path.is_dir() == folder):
        what = "a new or empty folder, or a folder" if folder else "a new file, or one"
        raise vb.io.InputError(f"sink {path}: already exists; allowed is {what} with --overwrite")
    return kind, (writable_folder if folder else writable)(path)


def _maker(kind: str, loaded: vb.Setup) -> Callable[[Any], vb.live.Sink]:
    """Function that makes a sink from a path; its libraries are loaded now, so that a missing one
    is reported before anyone waits.
    """
    from vibrissa.io.sinks import JsonLinesSink, PlySink  # noqa: PLC0415

    if kind == "jsonl":
        return JsonLinesSink
    if kind == "ply":
        return partial(PlySink, unit="metre" if loaded.rod.units == "SI" else "rod length")
    from vibrissa.io.rosbag import McapSink, Rosbag2Sink, library  # noqa: PLC0415

    for name in ("mcap.records", "mcap.data_stream", "rosbags.typesys"):
        library(name)
    sink = Rosbag2Sink if kind == "rosbag2" else McapSink
    return partial(sink, wrench_frame=loaded.sensor.wrench_frame)


def _text(report: vb.live.Report) -> str:
    from vibrissa.live.rdt import STATUS_BITS  # noqa: PLC0415

    counts, rate = report.counts, report.counts.samples / max(report.seconds, 1e-9)
    bits = ", ".join(
        f"{bit}: {STATUS_BITS.get(bit, 'not known')}"
        for bit in range(32)
        if counts.status >> bit & 1
    )
    median, slowest = (1e3 * (late or 0.0) for late in (report.latency_median, report.latency_999))
    said = {
        f"{counts.samples} samples in {report.seconds:.2f} s ({rate:.0f} a second), "
        f"{report.rows} rows: {common.listed(report.contacts)}": True,
        f"lost {counts.lost} in {counts.gaps} gaps ({counts.late} of them came too late), "
        f"reordered {counts.reordered}, duplicates {counts.duplicates}, "
        f"malformed {counts.malformed}, restarts {counts.restarts}, "
        f"thrown away here {report.overflow}": True,
        f"status was not zero in {counts.flagged} samples (bits {bits}), {counts.invalid} of them "
        "in error": counts.flagged,
        f"{report.without_pose} rows without a pose, {report.malformed_poses} poses "
        "malformed": report.without_pose or report.malformed_poses,
        f"silent {report.silences} times, for {report.silent_seconds:.2f} s "
        "altogether": report.silences,
        f"{report.unused} samples recorded without a row: the end came before their tare or their "
        "pose": report.unused,
        f"latency from arrival to contact: median {median:.2f} ms, 99.9th percentile "
        f"{slowest:.2f} ms": report.latency_median is not None,
        f"CPU share {report.cpu_share:.1%} of one core": True,
    }
    return "\n".join(text for text, known in said.items() if known)
