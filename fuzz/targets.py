"""What is fuzzed: a reader, and small good files to begin with."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests" / "unit"))


@dataclass(frozen=True)
class Target:
    """A reader of files with this suffix, and contents that it takes."""

    suffix: str
    read: Callable[[Path], object]
    seeds: list[bytes]


def csv() -> Target:
    """Recordings as text: the header of old, and columns by name, with dates and a decimal comma."""
    from bench_files import RECORDING

    import vibrissa as vb
    from vibrissa.io.recordings.table import RecordingTable

    setup = _setup()
    tables = (
        None,
        RecordingTable(),
        RecordingTable(time_unit="stamp"),
        RecordingTable(delimiter=";", decimal=",", pose_time="t2", time_offset=0.01),
    )

    def read(file: Path) -> None:
        _each(lambda table: vb.read_recording(file, replace(setup, recording=table)), tables)

    short = "".join(RECORDING.splitlines(keepends=True)[:16])
    german = (
        short.replace(",", ";")
        .replace(".", ",")
        .replace("time", "time;t2")
        .replace("\n0,", "\n0;0,")
    )
    lines = short.splitlines()
    dated = (
        "\n".join(
            [
                lines[0],
                *(
                    f"2026-11-21T20:00:{row:02d}.5Z," + line.split(",", 1)[1]
                    for row, line in enumerate(lines[1:])
                ),
            ]
        )
        + "\n"
    )
    return Target(".csv", read, [text.encode() for text in (short, german, dated)])


def toml() -> Target:
    """Setups and cases."""
    from bench_files import CASE, SETUP

    from vibrissa.io import load_case, load_setup

    layout = '[recording]\ntime_unit = "ms"\nforce = ["a", "b", "c"]\nforce_unit = "mN"\nposition = "p"\ntime_offset = "estimate"\nskip_lines = 2\n'
    shapes = '[rod]\nkind = "unit"\n[object]\nkind = "union"\nparts = [{kind = "torus", center = [0, 0, 1], axis = [0, 0, 1], major_radius = 1, minor_radius = 0.1}]\n'
    trails = '[[trail]]\nkind = "raster"\nstart = [1, 0, 0]\nstop = [0, 0, 0]\ncount = 9\nstep = [0, 1, 0]\ntrails = 3\n'

    def read(file: Path) -> None:
        _each(lambda load: load(file), (load_setup, load_case))

    return Target(
        ".toml", read, [text.encode() for text in (SETUP, SETUP + layout, CASE, shapes + trails)]
    )


def mcap() -> Target:
    """ROS bags as MCAP: plain, in chunks, packed, and cut off."""
    import vibrissa as vb
    from vibrissa.io.recordings.table import RecordingTable

    setup = _setup()
    tables = (None, RecordingTable(fixed_frame="world", sensor_frame="sensor", stamps="log"))

    def read(file: Path) -> None:
        _each(lambda table: vb.read_recording(file, replace(setup, recording=table)), tables)

    return Target(".mcap", read, list(_bags()))


def rdt() -> Target:
    """Datagrams of an Ethernet force/torque sensor, and requests to one."""
    from vibrissa.live.rdt import parse_records, parse_request

    def read(file: Path) -> None:
        data = file.read_bytes()
        _each(lambda parse: parse(data), (parse_records, parse_request))

    record = np.array([1, 1, 0, 10, -20, 30, 4, -5, 6], dtype=">i4").tobytes()
    return Target(".bin", read, [record, 40 * record, b"\x12\x34\x00\x02\x00\x00\x00\x00", b""])


TARGETS = {"csv": csv, "toml": toml, "mcap": mcap, "rdt": rdt}


def _each(read: Callable[[object], object], ways: tuple[object, ...]) -> None:
    """All ways, though the first ones refuse; a refusal other than a ValueError goes up at once."""
    refusals = []
    for way in ways:
        try:
            read(way)
        except ValueError as error:
            refusals.append(error)
    if refusals:
        raise ExceptionGroup("refused", refusals)


def _setup() -> object:
    from bench_files import SETUP

    from vibrissa.io import load_setup

    with TemporaryDirectory() as folder:
        file = Path(folder) / "setup.toml"
        file.write_text(SETUP.replace("tare_seconds = 0.85", "tare_seconds = 0.25"))
        return load_setup(file)


def _bags() -> Iterator[bytes]:
    from mcap_files import mcap_bytes

    for packing in ("none", "plain", "zstd", "lz4"):
        for frames in (False, True):
            whole = mcap_bytes(rows=4, packing=packing, frames=frames)
            yield whole
            yield whole[: 3 * len(whole) // 5]
    yield BytesIO(b"\x89MCAP0\r\n").getvalue()
