"""What `live` and `simulate-sensor` both take from a setup: the sensor's counts and its motion."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

import vibrissa as vb
from vibrissa.cli import common

if TYPE_CHECKING:
    from vibrissa.io.setup import RdtTable

_COUNTS, _RATE = 1e6, 1000.0
say = partial(common.say, err=True)
"""Print a line on stderr."""


@contextmanager
def working() -> Iterator[threading.Event]:
    """Give an event that SIGINT or SIGTERM sets. An error within becomes one line on stderr and
    exit status 1, or 2 if a library is not installed.
    """
    stop = threading.Event()
    before = {
        kind: signal.signal(kind, lambda *_: stop.set()) for kind in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    except ImportError as error:
        raise vb.io.InputError(str(error)) from error
    except (OSError, ValueError, vb.live.SilentSourceError) as error:
        text = str(error)
        if isinstance(error, OSError) and error.filename is not None:
            text = f"{error.filename}: {error.strerror}"
        say(f"vibrissa: error: {' '.join(text.splitlines())}")
        raise typer.Exit(1) from error
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


def rdt_of(loaded: vb.Setup) -> RdtTable:
    """The setup's table [rdt], or the usual defaults of such sensors."""
    from vibrissa.io.setup import RdtTable  # noqa: PLC0415

    if loaded.rdt is not None:
        return loaded.rdt
    say(
        f"the setup has no [rdt]: {_COUNTS:g} counts for 1 N and 1 N m, {_RATE:g} records a second "
        "are assumed"
    )
    return RdtTable(counts_per_force=_COUNTS, counts_per_torque=_COUNTS, rate=_RATE)


def poses_of(loaded: vb.Setup, folder: Path, *, needed: bool) -> vb.live.PoseSource:
    """Source of the sensor's pose, as [pose] says; `folder` is the setup's.

    Raises
    ------
    InputError
        If the table names a file that cannot be used, or an invalid address.
    """
    from vibrissa.files import read_table  # noqa: PLC0415
    from vibrissa.io import setup as tables  # noqa: PLC0415
    from vibrissa.live.address import host_and_port  # noqa: PLC0415
    from vibrissa.live.scene import motion  # noqa: PLC0415
    from vibrissa.trail import COLUMNS  # noqa: PLC0415

    table = loaded.pose
    try:
        match table:
            case None:
                if needed:
                    say("the setup has no [pose]: contacts are in the sensor's frame")
                return vb.live.ConstantPose()
            case tables.ConstantPoseTable():
                return vb.live.ConstantPose(table.position, table.orientation)
            case tables.UdpPoseTable():
                return vb.live.StreamedPoses(*host_and_port(table.listen), patience=table.patience)
            case tables.TrailPoseTable():
                file = folder / table.path
                time = read_table(file, ("time", *COLUMNS))["time"]
                time, poses = time - time[0], vb.Trail.from_csv(file)
            case tables.CasePoseTable():
                trail = vb.load_case(folder / table.path).trail
                time, clamp = motion(trail, rest=table.rest, sweep=table.sweep, pause=table.pause)
                poses = loaded.sensor.frame(clamp)
        return vb.live.TimedPoses(time, poses.position, poses.orientation)
    except vb.io.InputError:
        raise
    except ValueError as error:
        raise vb.io.InputError(f"[pose]: {error}") from error
