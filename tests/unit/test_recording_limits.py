"""Files cut off by a killed recorder, and files that claim more than they hold: what is whole is
read, and nothing takes memory that is not there.
"""

import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from struct import pack

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from bench_files import HEADER, RECORDING, SETUP
from mcap_files import (
    MAGIC,
    POSE,
    WRENCH,
    definitions,
    mcap_bytes,
    message,
    packed,
    record,
    text,
    whole,
    wrench_message,
)
from rosbags.rosbag2 import Reader
from scipy.io import savemat

import vibrissa as vb
from vibrissa.io import InputError, RecordingWarning
from vibrissa.io.recordings import mcap
from vibrissa.io.recordings.messages import Bag

TABLE = np.genfromtxt(RECORDING.splitlines()[1:], delimiter=",")


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> vb.Setup:
    file = tmp_path_factory.mktemp("setup") / "setup.toml"
    file.write_text(SETUP)
    return vb.load_setup(file)


def bag_of(folder: Path, content: bytes) -> Bag:
    file, bag = folder / "a.mcap", Bag()
    file.write_bytes(content)
    mcap.read(file, bag)
    return bag


@pytest.mark.parametrize("packing", ["none", "plain", "zstd", "lz4"])
@pytest.mark.parametrize("chunks", [1, 4])
def test_messages_are_those_of_the_library(tmp_path: Path, packing: str, chunks: int) -> None:
    """Byte by byte, against the reader of `rosbags`."""
    own = bag_of(tmp_path, mcap_bytes(packing=packing, chunks=chunks))
    with Reader(tmp_path / "a.mcap") as reader:
        theirs = [
            (connection.topic, time, bytes(data)) for connection, time, data in reader.messages()
        ]
    assert sorted(own.messages) == sorted(theirs)
    assert len(own.messages) == 80
    assert own.notes == []


@pytest.mark.parametrize("packing", ["none", "plain", "zstd", "lz4"])
def test_what_is_whole_of_a_file_that_is_cut_off_is_read_and_the_cut_is_said(
    tmp_path: Path, packing: str
) -> None:
    """At every 97th byte: the messages are the first ones, more of them the later the cut, and none
    is a part of one.
    """
    content = mcap_bytes(packing=packing, chunks=4)
    end = content.rindex(record(15, pack("<I", 0)))
    all_messages = bag_of(tmp_path, content).messages
    counts = []
    for cut in range(len(MAGIC), end, 97):
        bag = bag_of(tmp_path, content[:cut])
        assert bag.messages == all_messages[: len(bag.messages)]
        assert len(bag.notes) == 1
        assert f"of {cut} bytes" in bag.notes[0]
        assert f"{len(bag.messages)} messages" in bag.notes[0]
        counts.append(len(bag.messages))
    assert counts == sorted(counts)
    assert counts[-1] >= (79 if packing in {"none", "plain"} else 60)


def test_a_recording_that_is_cut_off_gives_its_reactions_with_a_warning(
    tmp_path: Path, setup: vb.Setup
) -> None:
    content = mcap_bytes(packing="plain")
    (tmp_path / "a.mcap").write_bytes(content[: len(content) * 2 // 3])
    with pytest.warns(RecordingWarning, match="cut off") as caught:
        found = vb.read_recording(tmp_path / "a.mcap", setup)
    assert 20 < len(found.force) < 40
    np.testing.assert_allclose(found.time, TABLE[: len(found.force), 0], atol=1e-9)
    assert all("a.mcap" in str(one.message) for one in caught)


def test_a_damaged_chunk_is_left_out_and_the_others_are_read(tmp_path: Path) -> None:
    first = packed(
        definitions([("/ft", WRENCH)]) + message(1, 1, wrench_message(TABLE[0])), "plain"
    )
    bad = packed(message(1, 2, wrench_message(TABLE[1])), "zstd", checksum=1)
    last = packed(message(1, 3, wrench_message(TABLE[2])), "lz4")
    bag = bag_of(tmp_path, whole(first + bad + last))
    assert [found.log_time for found in bag.messages] == [1, 3]
    assert "its checksum is wrong" in bag.notes[0]


def test_other_messages_and_encodings_are_passed_over(tmp_path: Path) -> None:
    """Such a bag holds pictures, and channels of other programs."""
    other = record(3, pack("<H", 7) + text("a.Picture") + text("jsonschema") + text("{}")) + record(
        4, pack("<HH", 7, 7) + text("/c") + text("json") + text("")
    )
    data = (
        definitions([("/ft", WRENCH)])
        + other
        + message(7, 1, b"{}")
        + message(1, 2, wrench_message(TABLE[0]))
        + record(200, b"of later versions")
    )
    bag = bag_of(tmp_path, whole(data))
    assert [found.topic for found in bag.messages] == ["/ft"]
    assert bag.topics == {"/ft": WRENCH, "/c": "a.Picture"}


def parquet_bomb(file: Path) -> None:
    pq.write_table(
        pa.table({name: np.zeros(3_000_000) for name in HEADER.split(",")}),
        file,
        compression="zstd",
    )


def hdf5_bomb(file: Path) -> None:
    with h5py.File(file, "w") as opened:
        for name in HEADER.split(","):
            opened.create_dataset(
                name,
                shape=(9_000_000,),
                dtype="f8",
                chunks=(100_000,),
                compression="gzip",
                fillvalue=0.5,
            )


def hdf5_chunk_bomb(file: Path) -> None:
    with h5py.File(file, "w") as opened:
        for name in HEADER.split(","):
            opened.create_dataset(
                name,
                shape=(40,),
                maxshape=(None,),
                dtype="f8",
                chunks=(500_000_000,),
                compression="gzip",
            )


def matlab_bomb(file: Path) -> None:
    """300 MB of zeros, packed into 300 kB."""
    savemat(file, {"time": np.zeros(4)}, do_compression=True)
    header = file.read_bytes()[:128]
    packer, piece = zlib.compressobj(9), bytes(2**20)
    inner = pack("<II", 14, 2**31 - 2**20)
    body = (
        packer.compress(inner)
        + b"".join(packer.compress(piece) for _ in range(300))
        + packer.flush()
    )
    file.write_bytes(header + pack("<II", 15, len(body)) + body)


def chunk_of_zeros(file: Path, *, claimed: int, size: int) -> None:
    """A chunk that unpacks to `size` bytes, and says something else."""
    from backports import zstd

    content = zstd.compress(bytes(size))
    chunk = record(
        6, pack("<QQQI", 0, 1, claimed, 0) + text("zstd") + pack("<Q", len(content)) + content
    )
    file.write_bytes(whole(definitions([("/ft", WRENCH), ("/pose", POSE)]) + chunk))


def long_record(file: Path) -> None:
    file.write_bytes(MAGIC + pack("<BQ", 1, 2**62) + b"ros2")


BOMBS: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "Parquet": ("a.parquet", parquet_bomb, "64 MiB or 100 times the file"),
    "HDF5": ("a.h5", hdf5_bomb, "64 MiB or 100 times the file"),
    "HDF5, one large chunk": ("a.h5", hdf5_chunk_bomb, "is stored in pieces of 500000000 numbers"),
    "MATLAB": ("a.mat", matlab_bomb, "64 MiB or 100 times the file"),
    "MCAP, a chunk that claims much": (
        "a.mcap",
        lambda file: chunk_of_zeros(file, claimed=2**40, size=100),
        "64 MiB or 100 times the file",
    ),
    "MCAP, a chunk that claims little": (
        "a.mcap",
        lambda file: chunk_of_zeros(file, claimed=2**20, size=2**30),
        "0 topics|no messages",
    ),
    "MCAP, a record without end": ("a.mcap", long_record, "cut off"),
}
READ = """
import resource, sys, warnings
import numpy, scipy.io, scipy.spatial, h5py, pyarrow.parquet, rosbags.typesys, vibrissa as vb
from vibrissa.io import InputError
setup = vb.load_setup(sys.argv[1])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
warnings.simplefilter("ignore")
for file in sys.argv[2:]:
    try:
        vb.read_recording(file, setup)
        print("taken")
    except InputError as error:
        print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def test_a_file_that_claims_gigabytes_is_refused_before_they_are_taken(tmp_path: Path) -> None:
    """In a process of its own: its memory grows by less than 250 MB over all of them, each of which
    stands for one to eight thousand.
    """
    (tmp_path / "setup.toml").write_text(SETUP)
    files = []
    for number, (name, write, _) in enumerate(BOMBS.values()):
        files.append(tmp_path / f"{number}{Path(name).suffix}")
        write(files[-1])
    run = subprocess.run(
        [sys.executable, "-c", READ, str(tmp_path / "setup.toml"), *map(str, files)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr[-2000:]
    *messages, grown = run.stdout.splitlines()
    for file, said, (_, _, words) in zip(files, messages, BOMBS.values(), strict=True):
        assert said.startswith(str(file))
        assert any(word in said for word in words.split("|")), said
    assert int(grown) < 250_000


def test_links_into_other_files_are_not_followed(tmp_path: Path, setup: vb.Setup) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as opened:
        for name, column in zip(HEADER.split(","), TABLE.T, strict=True):
            opened[name] = column
    with h5py.File(tmp_path / "a.h5", "w") as opened:
        for name in HEADER.split(","):
            opened[name] = h5py.ExternalLink("other.h5", name)
    with pytest.raises(InputError, match="time = 'time' is not in the file; it holds nothing"):
        vb.read_recording(tmp_path / "a.h5", setup)


def test_a_database_with_a_view_is_refused(tmp_path: Path, setup: vb.Setup) -> None:
    """A view can stand for rows without end."""
    import sqlite3

    with sqlite3.connect(tmp_path / "a.db3") as database:
        database.execute(
            "CREATE TABLE topics (id INTEGER, name TEXT, type TEXT, serialization_format TEXT)"
        )
        database.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n"
        )
    database.close()
    with pytest.raises(
        InputError, match="holds the view 'messages'; allowed are tables and indexes"
    ):
        vb.read_recording(tmp_path / "a.db3", setup)


def test_a_line_of_names_without_end_is_refused_at_once(tmp_path: Path, setup: vb.Setup) -> None:
    (tmp_path / "a.csv").write_text(",".join(["fx"] * 300_000) + "\n1\n")
    with pytest.raises(InputError) as caught:
        vb.read_recording(tmp_path / "a.csv", setup)
    assert len(str(caught.value)) < 1000
