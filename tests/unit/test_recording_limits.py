"""Files cut off by a killed recorder, and damaged ones: what is whole is read, and the rest said."""

from pathlib import Path
from struct import pack

import numpy as np
import pytest
from bench_files import RECORDING, SETUP
from mcap_files import (
    MAGIC,
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

import vibrissa as vb
from vibrissa.io import InputError, RecordingWarning
from vibrissa.io.recordings import containers

TABLE = np.genfromtxt(RECORDING.splitlines()[1:], delimiter=",")


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> vb.Setup:
    file = tmp_path_factory.mktemp("setup") / "setup.toml"
    file.write_text(SETUP)
    return vb.load_setup(file)


def bag_of(folder: Path, content: bytes) -> containers.Bag:
    file = folder / "a.mcap"
    file.write_bytes(content)
    return containers.bag_of(file)


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


def test_a_line_of_names_without_end_is_refused_at_once(tmp_path: Path, setup: vb.Setup) -> None:
    (tmp_path / "a.csv").write_text(",".join(["fx"] * 300_000) + "\n1\n")
    with pytest.raises(InputError) as caught:
        vb.read_recording(tmp_path / "a.csv", setup)
    assert len(str(caught.value)) < 1000
