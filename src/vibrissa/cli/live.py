"""`vibrissa live`: a sensor's stream to contacts, as it comes."""

import gc
import json
import os
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from vibrissa.io import Setup
    from vibrissa.live import Address, Report, Sink, Source

SINKS = "FILE.mcap, rosbag2:FOLDER, FILE.ply, FILE.jsonl, jsonl:FILE and jsonl:- (standard output)"


def live(
    source: Annotated[
        str,
        typer.Option(
            "--source",
            help="netft://HOST[:PORT], tcp://HOST:PORT, serial:DEVICE[?baud=N] or replay:FILE[?speed=X].",
        ),
    ],
    setup: Annotated[
        Path,
        typer.Option(
            "--setup", help="TOML file with [rod], [sensor] and, for a sensor, [rdt] and [pose]."
        ),
    ],
    sink: Annotated[
        list[str] | None, typer.Option("--sink", help=f"{SINKS}; may be given again.")
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option("--duration", help="Seconds after the first sample at which to end."),
    ] = None,
    batch: Annotated[
        float, typer.Option("--batch", help="Seconds of samples that are worked on together.")
    ] = 0.005,
    silence: Annotated[
        float,
        typer.Option(
            "--silence", help="Seconds without a sample after which to give up; 0 for never."
        ),
    ] = 5.0,
    friction: Annotated[
        float | None,
        typer.Option(
            "--friction", help="Coulomb's coefficient: 0 for none; left out where it is not known."
        ),
    ] = None,
    smooth: Annotated[
        bool,
        typer.Option(
            "--smooth", help="Smooth the contacts as they come: each from all samples up to it."
        ),
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files that are there.")
    ] = False,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print the summary as JSON; to stderr if a sink takes stdout."),
    ] = False,
) -> None:
    """Reconstruct contacts from a running sensor, record them and the raw wrench. Ends with the
    source, after --duration, or on an interrupt.
    """
    from vibrissa.io.errors import InputError  # noqa: PLC0415
    from vibrissa.io.setup import load_setup  # noqa: PLC0415
    from vibrissa.live.address import parse_address  # noqa: PLC0415

    for name, value, least in (
        ("--duration", duration, 0.0),
        ("--batch", batch, 0.0),
        ("--silence", silence, -1.0),
        ("--friction", friction, -1.0),
    ):
        if value is not None and not (max(least, 0.0) <= value < float("inf") and value > least):
            raise InputError(
                f"{name} = {value}; allowed is a finite number {'greater than' if least == 0 else 'of at least'} 0"
            )
    address = parse_address(source)
    targets = [_target(text, overwrite=overwrite) for text in sink or []]
    _check_different(targets)
    loaded = load_setup(setup)
    report = _run(
        address,
        loaded,
        setup.parent,
        targets,
        duration=duration,
        batch=batch,
        silence=silence,
        friction=friction,
        smooth=smooth,
    )
    if as_json:
        typer.echo(
            json.dumps(report.as_dict(), indent=1), err=any(path is None for _, path in targets)
        )
    else:
        typer.echo(_text(report), err=True)
    if report.silent:
        raise typer.Exit(1)


def _run(
    address: "Address",
    loaded: "Setup",
    folder: Path,
    targets: "list[tuple[str, Path | None]]",
    *,
    duration: float | None,
    batch: float,
    silence: float,
    friction: float | None,
    smooth: bool,
) -> "Report":
    from vibrissa.cli.live_parts import interrupts, one_line, poses_of  # noqa: PLC0415
    from vibrissa.io.errors import InputError  # noqa: PLC0415
    from vibrissa.live import Processor, SmoothingStage, stream  # noqa: PLC0415

    # Batches are small: one thread on this machine answers soonest, in the order of the calls.
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    os.environ.setdefault("JAX_CPU_ENABLE_ASYNC_DISPATCH", "false")
    _say("loading")
    origin = _source(address, loaded)
    poses = poses_of(loaded, folder, needed=address.kind == "netft")
    if smooth and loaded.sensor.force_noise is None:
        raise InputError(
            "sensor.force_noise is not given with --smooth; allowed is a setup with force_noise and torque_noise"
        )
    stage = SmoothingStage(loaded.rod, friction=friction) if smooth else None
    processor = Processor(
        loaded.rod,
        loaded.sensor,
        poses,
        stage=stage,
        friction=friction,
        tolerances=loaded.parameter_covariance,
    )
    with interrupts() as stop, one_line():
        sinks = partial(_sinks, [(_maker(kind, loaded), path) for kind, path in targets])
        processor.warm_up()
        # No pause for what was made up to here, and short turns: the thread that reads must not
        # wait for the one that works.
        gc.collect()
        gc.freeze()
        sys.setswitchinterval(1e-3)
        return stream(
            origin,
            processor,
            sinks,
            poses=poses,
            duration=duration,
            batch_seconds=batch,
            silence=silence,
            stop=stop,
            notice=_say,
        )


def _say(text: str) -> None:
    typer.echo(text, err=True)


def _source(address: "Address", loaded: "Setup") -> "Source":
    from vibrissa.cli.live_parts import rdt_of  # noqa: PLC0415
    from vibrissa.io.live_setup import UdpPoseTable  # noqa: PLC0415
    from vibrissa.io.recordings.read import read_cleaned  # noqa: PLC0415
    from vibrissa.live.lines import LineSource, SerialLine, TcpLine  # noqa: PLC0415
    from vibrissa.live.netft import NetFtSource  # noqa: PLC0415
    from vibrissa.live.replay import ReplaySource  # noqa: PLC0415

    match address.kind:
        case "replay":
            return ReplaySource(read_cleaned(address.path, loaded), address.speed)
        case "tcp":
            return LineSource(
                TcpLine(address.path, address.port),
                on_host_clock=isinstance(loaded.pose, UdpPoseTable),
            )
        case "serial":
            return LineSource(
                SerialLine(address.path, address.baud),
                on_host_clock=isinstance(loaded.pose, UdpPoseTable),
            )
    table = rdt_of(loaded)
    return NetFtSource(
        address.path,
        address.port,
        counts_per_force=table.counts_per_force,
        counts_per_torque=table.counts_per_torque,
        rate=table.rate,
        buffered=table.buffered,
        bias=table.bias,
        error_bits=table.error_bits,
    )


def _target(text: str, *, overwrite: bool) -> "tuple[str, Path | None]":
    """Kind and file of a sink, or folder."""
    from vibrissa.io.errors import InputError, writable, writable_folder  # noqa: PLC0415

    if text == "jsonl:-":
        return "jsonl", None
    given, _, rest = text.partition(":")
    kind, path = (
        (given, Path(rest))
        if given in ("jsonl", "rosbag2")
        else (Path(text).suffix.lower()[1:], Path(text))
    )
    if kind not in ("mcap", "ply", "jsonl", "rosbag2") or not (
        path.name or (kind == "rosbag2" and rest)
    ):
        raise InputError(f"sink {text!r}; allowed are {SINKS}")
    if kind == "rosbag2":
        if path.exists() and not (path.is_dir() and (overwrite or not any(path.iterdir()))):
            raise InputError(
                f"sink {path}: is there already; allowed is a new or empty folder, or a folder with --overwrite"
            )
        return kind, writable_folder(path)
    if path.exists() and path.is_file() and not overwrite:
        raise InputError(f"sink {path}: is there already; allowed is a new file, or --overwrite")
    return kind, writable(path)


def _check_different(targets: "list[tuple[str, Path | None]]") -> None:
    """No two sinks write one file."""
    from vibrissa.io.errors import InputError  # noqa: PLC0415

    places = [None if path is None else path.resolve() for _, path in targets]
    for place in places:
        if places.count(place) > 1:
            raise InputError(
                f"sink {'jsonl:-' if place is None else place}: is given twice; allowed is one sink for each file"
            )


def _maker(kind: str, loaded: "Setup") -> "Callable[[Any], Sink]":
    """What makes a sink of a path; its libraries are loaded now, so that one that is missing is
    said before anyone waits.
    """
    from vibrissa.io.sinks import JsonLinesSink, PlySink  # noqa: PLC0415

    if kind == "jsonl":
        return JsonLinesSink
    if kind == "ply":
        return partial(PlySink, unit="metre" if loaded.rod.units == "SI" else "rod length")
    from vibrissa.io.rosbag import McapSink, Rosbag2Sink  # noqa: PLC0415
    from vibrissa.io.rosbag.library import library  # noqa: PLC0415

    for name in (
        "mcap.records",
        "mcap.data_stream",
        "rosbags.typesys",
        *(("ruamel.yaml",) if kind == "rosbag2" else ()),
    ):
        library(name)
    return partial(
        Rosbag2Sink if kind == "rosbag2" else McapSink, wrench_frame=loaded.sensor.wrench_frame
    )


def _sinks(makers: "list[tuple[Callable[[Any], Sink], Path | None]]") -> "Iterator[Sink]":
    """Made one by one, so that those that are there are closed where the next cannot be made."""
    for make, path in makers:
        yield make(path)


def _text(report: "Report") -> str:
    counts = report.counts
    lines = [
        f"{counts.samples} samples in {report.seconds:.2f} s ({counts.samples / max(report.seconds, 1e-9):.0f} a second), {report.rows} rows: "
        + ", ".join(f"{count} {name.lower()}" for name, count in report.contacts.items()),
        f"lost {counts.lost} in {counts.gaps} gaps ({counts.late} of them came too late), put in order {counts.reordered}, "
        f"double {counts.duplicates}, malformed {counts.malformed}, restarts {counts.restarts}, thrown away here {report.overflow}",
    ]
    if counts.flagged:
        from vibrissa.live.rdt import STATUS_BITS  # noqa: PLC0415

        bits = ", ".join(
            f"{bit}: {STATUS_BITS.get(bit, 'not known')}"
            for bit in range(32)
            if counts.status >> bit & 1
        )
        lines.append(
            f"status was not zero in {counts.flagged} samples (bits {bits}), {counts.invalid} of them in error"
        )
    if report.without_pose or report.malformed_poses:
        lines.append(
            f"{report.without_pose} rows without a pose, {report.malformed_poses} poses malformed"
        )
    if report.silences:
        lines.append(
            f"silent {report.silences} times, for {report.silent_seconds:.2f} s altogether"
        )
    if report.unused:
        lines.append(
            f"{report.unused} samples recorded without a row: the end came before their tare or their pose"
        )
    if report.latency_median is not None and report.latency_999 is not None:
        lines.append(
            f"latency from arrival to contact: median {report.latency_median * 1e3:.2f} ms, 99.9th percentile {report.latency_999 * 1e3:.2f} ms"
        )
    lines.append(f"CPU share {report.cpu_share:.1%} of one core")
    return "\n".join(lines)
