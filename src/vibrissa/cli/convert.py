"""`vibrissa convert`: a recording in another format."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.progress import reporting


def convert(
    recording: Annotated[Path, typer.Argument(help="Sensor log.")],
    setup: common.SetupFile,
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            help="x.csv, x.parquet, x.nc, x.mat, x.mcap or rosbag2:FOLDER.",
        ),
    ],
) -> None:
    """Write a recording in another format, which `reconstruct` reads to the same numbers."""
    with reporting() as report:
        report("converting")
        found = vb.io.convert_recording(recording, setup, output)
    for note in found.notes:
        warnings.warn(f"{recording}: {note}", vb.io.RecordingWarning, stacklevel=1)
    files = [found.recording] if found.setup == setup else [found.recording, found.setup]
    common.say(f"{common.count_of(found.rows, 'row')}{common.into(*files)}")
