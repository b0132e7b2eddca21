"""Hypothesis writes bad files of every kind: the readers take them or say in one line what is
wrong, and nothing else happens.

The coverage-guided counterpart is in `fuzz/`.
"""

import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from bench_files import CASE, HEADER, ONE_PUSH, SETUP
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap_files import mcap_bytes
from scipy.io import netcdf_file, savemat

import vibrissa as vb
from vibrissa.io import InputError
from vibrissa.io.recordings.table import RecordingTable

TORN = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
NAMES = HEADER.split(",")
TABLE = np.genfromtxt(ONE_PUSH.splitlines()[1:], delimiter=",")
LAYOUTS = (
    None,
    RecordingTable(),
    RecordingTable(time_unit="stamp", delimiter=";", decimal=","),
    RecordingTable(
        force="force",
        orientation=("qx", "qy", "qz"),
        orientation_form="rotation_vector",
        angle_unit="deg",
        pose_time="time[0]",
    ),
    RecordingTable(time_offset="estimate", largest_offset=0.5, fixed_frame="world", stamps="log"),
)


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> vb.Setup:
    file = tmp_path_factory.mktemp("setup") / "setup.toml"
    file.write_text(SETUP)
    return vb.load_setup(file)


def taken_or_refused(read: Callable[[Path], object], file: Path, content: bytes) -> None:
    file.write_bytes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", vb.io.RecordingWarning)
            read(file)
    except InputError as error:
        message = str(error)
        assert message.startswith(str(file))
        assert len(message.splitlines()) == 1
        assert len(message) < 2000
        assert "allowed" in message or "it holds" in message or "the bag holds" in message


def binary(write: Callable[[Path], object], folder: Path) -> bytes:
    write(folder / "good")
    return (folder / "good").read_bytes()


def hdf5(file: Path) -> None:
    with h5py.File(file, "w") as opened:
        for name, column in zip(NAMES, TABLE.T, strict=True):
            opened.create_dataset(name, data=column, compression="gzip")


def netcdf(file: Path) -> None:
    with netcdf_file(file, "w") as opened:
        opened.createDimension("sample", len(TABLE))
        for name, column in zip(NAMES, TABLE.T, strict=True):
            opened.createVariable(name, "d", ("sample",))[:] = column


def matlab(file: Path) -> None:
    with file.open("wb") as opened:
        savemat(opened, dict(zip(NAMES, TABLE.T, strict=True)), do_compression=False)


WRITERS: dict[str, Callable[[Path], object]] = {
    "csv": lambda file: file.write_text(ONE_PUSH),
    "parquet": lambda file: pq.write_table(pa.table(dict(zip(NAMES, TABLE.T, strict=True))), file),
    "h5": hdf5,
    "nc": netcdf,
    "mat": matlab,
    "mcap": lambda file: file.write_bytes(mcap_bytes(rows=12)),
    "zstd.mcap": lambda file: file.write_bytes(
        mcap_bytes(rows=12, packing="zstd", chunks=2, frames=True)
    ),
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return {name: binary(write, tmp_path_factory.mktemp("good")) for name, write in WRITERS.items()}


NUMBERS = (
    b"\xff" * 8,
    b"\x00" * 8,
    b"\xff" * 4,
    (2**31 - 1).to_bytes(4, "little"),
    (2**40).to_bytes(8, "little"),
    (2**62).to_bytes(8, "big"),
)
STRETCHES = (
    b"1e400",
    b"-1e-400",
    b"9" * 5000,
    b"\x00",
    b"\xef\xbb\xbf",
    b"\xff\xfe",
    b"nan",
    b",,,,",
    b"\r",
    b"\x0c",
    b'"',
    "\u2028".encode(),
    b"a" * 70_000,
)


@st.composite
def damage(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """Up to six places at which something is cut out, overwritten, doubled, or put in; places are
    shares of the file, more of them at its ends.
    """
    places = []
    for _ in range(draw(st.integers(1, 6))):
        share = draw(st.one_of(st.floats(0, 1), st.floats(0, 0.1), st.floats(0.9, 1)))
        places.append(
            (
                share,
                draw(st.integers(0, 40)),
                draw(
                    st.one_of(
                        st.none(), st.binary(max_size=8), st.sampled_from(NUMBERS + STRETCHES)
                    )
                ),
            )
        )
    end = draw(st.one_of(st.just(1.0), st.just(1.0), st.floats(0, 1)))

    def damaged(content: bytes) -> bytes:
        for share, length, put in places:
            at = int(share * len(content))
            content = (
                content[:at]
                + (2 * content[at : at + length] if put is None else put)
                + content[at + length :]
            )
        return content[: int(end * len(content))]

    return damaged


class Elsewhere:
    """Another process, which a reader may end (docs/recordings.md)."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Start, for the first time or again."""
        self.pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"))

    def read(self, setup: vb.Setup, layout: RecordingTable | None, file: Path, text: bytes) -> None:
        """Take or refuse a recording; skip one on which SciPy or pyarrow ends the process."""
        try:
            self.pool.submit(taken_as, setup, layout, file, text).result()
        except BrokenProcessPool:
            self.start()
            assert file.suffix in {".mat", ".parquet"}


def taken_as(setup: vb.Setup, layout: RecordingTable | None, file: Path, content: bytes) -> None:
    """As a layout says."""
    taken_or_refused(
        lambda file: vb.read_recording(file, replace(setup, recording=layout)), file, content
    )


@pytest.fixture(scope="module")
def elsewhere() -> Iterator[Elsewhere]:
    process = Elsewhere()
    yield process
    process.pool.shutdown()


@pytest.mark.parametrize("name", WRITERS)
@TORN
@given(damage=damage(), layout=st.sampled_from(LAYOUTS))
def test_damaged_recordings(
    tmp_path: Path,
    setup: vb.Setup,
    elsewhere: Elsewhere,
    good: dict[str, bytes],
    name: str,
    damage: Callable[[bytes], bytes],
    layout: RecordingTable | None,
) -> None:
    elsewhere.read(setup, layout, tmp_path / f"a.{name}", damage(good[name]))


SIGNS = (
    b"",
    b"PAR1",
    b"\x89HDF\r\n\x1a\n",
    b"CDF\x01",
    b"CDF\x02",
    b"MATLAB 5.0",
    b"MATLAB 7.3",
    b"\x89MCAP0\r\n",
    b"SQLite format 3\0",
    b"\x28\xb5\x2f\xfd",
)


@TORN
@given(
    sign=st.sampled_from(SIGNS),
    content=st.binary(max_size=300),
    suffix=st.sampled_from((".csv", ".mat", ".h5", ".parquet", ".mcap", ".nc", "")),
)
def test_arbitrary_bytes(
    tmp_path: Path, setup: vb.Setup, elsewhere: Elsewhere, sign: bytes, content: bytes, suffix: str
) -> None:
    elsewhere.read(setup, None, tmp_path / f"a{suffix}", sign + content)


@pytest.mark.parametrize("load", [vb.load_setup, vb.load_case])
@TORN
@given(damage=damage())
def test_damaged_setups_and_cases(
    tmp_path: Path, load: Callable[[Path], object], damage: Callable[[bytes], bytes]
) -> None:
    text = (
        SETUP + '[recording]\nforce = ["a", "b", "c"]\ntime_offset = 0.1\n'
        if load is vb.load_setup
        else CASE
    )
    taken_or_refused(load, tmp_path / "a.toml", damage(text.encode()))


HOSTILE = {
    "lists in lists": "a = " + "[" * 5000 + "]" * 5000 + "\n",
    "tables in tables": "a = " + "{a = " * 3000 + "1" + "}" * 3000 + "\n",
    "a number of 400,000 digits": SETUP.replace("radius = 0.25e-3", "radius = " + "9" * 400_000),
    "a number beyond all": SETUP.replace("radius = 0.25e-3", "radius = 1e400"),
    "a raster of 400,000,000 positions": CASE[: CASE.index("[[trail]]")]
    + '[[trail]]\nkind = "raster"\nstart = [1, 0, 0]\nstop = [0, 0, 0]\ncount = 20000\nstep = [0, 1, 0]\ntrails = 20000\n',
    "forty trails of 1,000,000 positions": CASE[: CASE.index("[[trail]]")]
    + '[[trail]]\nkind = "line"\nstart = [1, 0, 0]\nstop = [0, 0, 0]\ncount = 1000000\n' * 40,
    "a byte order mark": "\ufeff" + SETUP,
    "a zero byte": SETUP.replace("cylinder", "cyl\0inder"),
}
READ = """
import resource, sys
import vibrissa as vb
from vibrissa.io import InputError, load_case, load_setup
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for file in sys.argv[1:]:
    for load in (load_setup, load_case):
        try:
            load(file)
            print("taken")
        except InputError as error:
            print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def test_hostile_toml_takes_no_memory(tmp_path: Path) -> None:
    """In a process of its own, whose memory grows by less than 250 MB over all of them."""
    files = []
    for number, text in enumerate(HOSTILE.values()):
        files.append(tmp_path / f"{number}.toml")
        files[-1].write_text(text)
    run = subprocess.run(
        [sys.executable, "-c", READ, *map(str, files)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr[-2000:]
    *messages, grown = run.stdout.splitlines()
    for file, said in zip([file for file in files for _ in range(2)], messages, strict=True):
        assert said.startswith(f"{file}: ")
        assert "allowed" in said
    assert int(grown) < 250_000
