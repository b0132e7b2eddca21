"""What `live` and `simulate-sensor` both take from a setup: how the sensor counts, and where it
moves.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from vibrissa.io import Setup
    from vibrissa.io.live_setup import CasePoseTable, RdtTable
    from vibrissa.live.poses import PoseSource, TimedPoses
    from vibrissa.sensor import Sensor
    from vibrissa.trail import Trail

_COUNTS, _RATE = 1e6, 1000.0


@contextmanager
def interrupts() -> Iterator[threading.Event]:
    """An event that an interrupt or a request to terminate sets."""
    stop = threading.Event()
    before = {
        kind: signal.signal(kind, lambda *_: stop.set()) for kind in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


@contextmanager
def one_line() -> Iterator[None]:
    """Failed work is one line on stderr and exit status 1."""
    from vibrissa.live.loop import SilentSourceError  # noqa: PLC0415

    try:
        yield
    except (OSError, ImportError, ValueError, SilentSourceError) as error:
        text = (
            f"{error.filename}: {error.strerror}"
            if isinstance(error, OSError) and error.filename is not None
            else str(error)
        )
        typer.echo(f"vibrissa: error: {' '.join(text.splitlines())}", err=True)
        raise typer.Exit(1) from error


def rdt_of(loaded: "Setup") -> "RdtTable":
    """Table [rdt] of the setup, or what such sensors do unless set otherwise."""
    from vibrissa.io.live_setup import RdtTable  # noqa: PLC0415

    if loaded.rdt is not None:
        return loaded.rdt
    typer.echo(
        f"the setup has no [rdt]: {_COUNTS:g} counts for 1 N and 1 N m, {_RATE:g} records a second are taken",
        err=True,
    )
    return RdtTable(counts_per_force=_COUNTS, counts_per_torque=_COUNTS, rate=_RATE)


def poses_of(loaded: "Setup", folder: Path, *, needed: bool) -> "PoseSource":
    """Where the sensor's pose comes from, as [pose] says; `folder` is the setup's.

    Raises
    ------
    InputError
        If the table names a file that cannot be used, or an address that is none.
    """
    from vibrissa.io.errors import InputError  # noqa: PLC0415
    from vibrissa.io.live_setup import (  # noqa: PLC0415
        CasePoseTable,
        ConstantPoseTable,
        TrailPoseTable,
        UdpPoseTable,
    )
    from vibrissa.live.address import host_and_port  # noqa: PLC0415
    from vibrissa.live.poses import ConstantPose, StreamedPoses  # noqa: PLC0415

    table = loaded.pose
    try:
        match table:
            case UdpPoseTable():
                return StreamedPoses(*host_and_port(table.listen), patience=table.patience)
            case TrailPoseTable():
                return _from_csv(folder / table.path)
            case CasePoseTable():
                return _from_case(table, folder, loaded.sensor)
            case ConstantPoseTable():
                return ConstantPose(table.position, table.orientation)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"[pose]: {error}") from error
    if needed:
        typer.echo("the setup has no [pose]: contacts are in the sensor's frame", err=True)
    return ConstantPose()


def _from_csv(file: Path) -> "TimedPoses":
    import numpy as np  # noqa: PLC0415

    from vibrissa.files import check_increasing, read_table  # noqa: PLC0415
    from vibrissa.live.poses import TimedPoses  # noqa: PLC0415
    from vibrissa.trail import COLUMNS  # noqa: PLC0415

    table = read_table(file, ("time", *COLUMNS), any_order=True)
    check_increasing(file, table["time"])
    columns = np.column_stack([table[name] for name in COLUMNS])
    return TimedPoses(table["time"] - table["time"][0], columns[:, :3], columns[:, 3:])


def _from_case(table: "CasePoseTable", folder: Path, sensor: "Sensor") -> "TimedPoses":
    from vibrissa.io.case import load_case  # noqa: PLC0415
    from vibrissa.live.poses import TimedPoses  # noqa: PLC0415
    from vibrissa.live.scene import motion, sensor_poses  # noqa: PLC0415

    trail: Trail = load_case(folder / table.path).trail
    time, clamp = motion(trail, rest=table.rest, sweep=table.sweep, pause=table.pause)
    poses = sensor_poses(sensor, clamp)
    return TimedPoses(time, poses.position, poses.orientation)
