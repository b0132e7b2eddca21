"""An MCAP file opens in the libraries' own readers after every step of its being written, however a
write is torn.
"""

import io
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader

from vibrissa.io import InputError
from vibrissa.io.disk import FileDisk
from vibrissa.io.rosbag import growing, mend
from vibrissa.io.rosbag.growing import PAGE, Channel, GrowingFile, Messages

CHANNELS = [
    Channel("/a", "std_msgs/msg/String", "string data\n"),
    Channel("/b", "std_msgs/msg/String", "string data\n"),
]
QOS = ""
Message = tuple[str, int, bytes]


class Paper(FileDisk):
    """A disk that remembers every write."""

    def __init__(self) -> None:
        self.steps: list[tuple[int, bytes | None]] = []

    def write(self, data: bytes, place: int) -> None:
        """Note it."""
        self.steps.append((place, data))

    def truncate(self, size: int) -> None:
        """Note it."""
        self.steps.append((size, None))

    def close(self) -> None:
        """Nothing is held open."""


def carried_out(content: bytearray, step: tuple[int, bytes | None]) -> bytearray:
    place, data = step
    if data is None:
        return content[:place]
    out = content + bytes(max(0, place + len(data) - len(content)))
    out[place : place + len(data)] = data
    return out


def torn(content: bytearray, step: tuple[int, bytes | None]) -> Iterator[bytearray]:
    """The file where the step was cut off at the ends of pages: that is where the kernel looks
    whether the process is to die.
    """
    place, data = step
    first = -(-place // PAGE) * PAGE
    for cut in range(first, place + len(data or b""), PAGE):
        if cut > place:
            yield carried_out(content, (place, (data or b"")[: cut - place]))


def messages(
    rng: np.random.Generator, channel: int, first: int, count: int
) -> tuple[Messages, list[Message]]:
    """Records of strings, and what they say."""
    data, offsets, said = b"", [], []
    for number in range(first, first + count):
        text = rng.bytes(int(rng.integers(0, 300))).hex().encode()
        body = b"\x00\x01\x00\x00" + struct.pack("<I", len(text) + 1) + text + b"\x00"
        offsets.append(len(data))
        data += (
            struct.pack("<BQHIQQ", 5, 22 + len(body), channel + 1, number, number, number) + body
        )
        said.append((CHANNELS[channel].topic, number, body))
    times = np.arange(first, first + count, dtype=np.int64)
    return Messages(channel, times, np.array(offsets, dtype=np.int64), data), said


def by_mcap(content: bytes) -> list[Message]:
    return [
        (channel.topic, message.log_time, message.data)
        for _, channel, message in make_reader(
            io.BytesIO(content), validate_crcs=True
        ).iter_messages()
    ]


def by_mcap_from_front_to_end(content: bytes) -> list[Message]:
    return [
        (channel.topic, message.log_time, message.data)
        for _, channel, message in NonSeekingReader(io.BytesIO(content)).iter_messages()
    ]


def by_rosbags(content: bytes, folder: Path) -> list[Message]:
    file = folder / "cut.mcap"
    file.write_bytes(content)
    with AnyReader([file]) as reader:
        found = [
            (connection.topic, moment, bytes(data))
            for connection, moment, data in reader.messages()
        ]
        assert reader.message_count == len(found)
        assert {connection.topic for connection in reader.connections} == {"/a", "/b"}
    return found


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_whole_after_every_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """Chunks of all sizes into a file with so little room that it grows again and again; each state
    is read three ways.
    """
    monkeypatch.setattr(growing, "ROOM", 2 * PAGE)
    rng = np.random.default_rng(seed)
    paper = Paper()
    file = GrowingFile(paper, CHANNELS, QOS)
    created, said, number, complete = len(paper.steps), [], 0, []
    for _ in range(12):
        blocks = []
        for channel in (0, 1):
            block, words = messages(rng, channel, number, int(rng.choice([0, 1, 3, 25])))
            number += len(words)
            said += words
            blocks.append(block)
        file.append(blocks)
        complete.append((len(paper.steps), len(said)))
    file.close()
    content, checked = bytearray(), 0
    for place, step in enumerate(paper.steps):
        if place >= created:
            known = max((count for steps, count in complete if steps <= place), default=0)
            for state in (content, *torn(content, step)):
                assert by_mcap(bytes(state)) == said[:known]
                assert by_rosbags(bytes(state), tmp_path) == said[:known]
                checked += 1
        content = carried_out(content, step)
    assert checked > 60
    assert (
        by_mcap(bytes(content))
        == by_mcap_from_front_to_end(bytes(content))
        == by_rosbags(bytes(content), tmp_path)
        == said
    )


class FullDisk(Paper):
    """Refuses every write that would make the file longer than this, as a disk that is full; what
    was written over stays writable.
    """

    def __init__(self, room: int) -> None:
        super().__init__()
        self._left = room

    def write(self, data: bytes, place: int) -> None:
        """Note it, or raise."""
        if place + len(data) > self._left:
            raise OSError(28, "No space left on device")
        super().write(data, place)


@pytest.mark.parametrize("pages", range(3, 16))
def test_a_disk_that_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pages: int) -> None:
    """Wherever it ends: what was written stays readable, also after the file was closed, which
    fails or not.
    """
    monkeypatch.setattr(growing, "ROOM", 2 * PAGE)
    rng, disk, said, number = np.random.default_rng(pages), FullDisk(pages * PAGE), [], 0
    file = GrowingFile(disk, CHANNELS, QOS)
    with pytest.raises(OSError, match="No space left"):
        for _ in range(100):
            block, words = messages(rng, 0, number, 5)
            number += len(words)
            file.append([block])
            said += words
    for _ in range(2):
        content = bytearray()
        for step in disk.steps:
            content = carried_out(content, step)
        assert by_mcap(bytes(content)) == said
        assert by_rosbags(bytes(content), tmp_path) == said
        with suppress(OSError):
            file.close()
    assert said


@pytest.mark.parametrize("seed", [4, 5])
def test_each_step_that_counts_lies_within_a_page(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """Heads of records are overwritten in one piece, wherever chunks happen to end."""
    monkeypatch.setattr(growing, "ROOM", 2 * PAGE)
    rng, paper, number = np.random.default_rng(seed), Paper(), 0
    file = GrowingFile(paper, CHANNELS, QOS)
    for _ in range(300):
        block, words = messages(rng, 0, number, int(rng.integers(1, 4)))
        number += len(words)
        file.append([block])
    small = [(place, data) for place, data in paper.steps if data is not None and len(data) < 40]
    assert len(small) > 300
    assert [
        place for place, data in small if place // PAGE != (place + len(data) - 1) // PAGE
    ] == []


def test_a_file_grows_with_what_it_holds(tmp_path: Path) -> None:
    """A closed file holds no room: a megabyte at most is more than the messages while it is open."""
    file = tmp_path / "x.mcap"
    growing_file = GrowingFile(FileDisk(file), CHANNELS, QOS)
    block, said = messages(np.random.default_rng(0), 0, 0, 2000)
    for start in range(0, 2000, 100):
        part = slice(start, start + 100)
        end = block.offset[start + 100] if start + 100 < 2000 else len(block.data)
        growing_file.append(
            [
                Messages(
                    0,
                    block.log_time[part],
                    block.offset[part] - block.offset[start],
                    block.data[block.offset[start] : end],
                )
            ]
        )
    assert file.stat().st_size < 2 * growing.ROOM + len(block.data)
    assert growing_file.message_counts == [2000, 0]
    growing_file.close()
    assert file.stat().st_size < 1.2 * len(block.data)
    assert by_mcap(file.read_bytes()) == said


def test_no_messages_is_a_whole_file(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    nothing = GrowingFile(FileDisk(file), CHANNELS, QOS)
    nothing.append([])
    assert by_mcap(file.read_bytes()) == by_rosbags(file.read_bytes(), tmp_path) == []
    nothing.close()
    assert by_mcap(file.read_bytes()) == by_rosbags(file.read_bytes(), tmp_path) == []


def chunks_of(folder: Path, number: int) -> tuple[Path, list[tuple[int, list[Message]]]]:
    """A file whose process was killed, and for each chunk where it ends and what the file holds by
    then.
    """
    file, said, ends = folder / "open.mcap", [], []
    rng, disk = np.random.default_rng(1), FileDisk(file)
    growing_file = GrowingFile(disk, CHANNELS, QOS)
    for chunk in range(number):
        block, words = messages(rng, chunk % 2, 10 * chunk, 10)
        growing_file.append([block])
        said = said + words
        ends.append((growing_file._room, said))
    disk.close()
    return file, ends


def test_of_a_file_cut_anywhere_every_whole_chunk_is_saved(tmp_path: Path) -> None:
    file, ends = chunks_of(tmp_path, 6)
    content, rng = file.read_bytes(), np.random.default_rng(2)
    for number, cut in enumerate(
        [8, 100, *rng.integers(900, ends[-1][0] + 50, 40).tolist(), len(content) - 1, len(content)]
    ):
        damaged, target = tmp_path / "cut.mcap", tmp_path / f"{number}.mcap"
        damaged.write_bytes(content[:cut])
        least = max((len(said) for end, said in ends if end <= cut), default=0)
        count = mend(damaged, target)
        saved = by_mcap(target.read_bytes())
        assert count == len(saved)
        assert saved == ends[-1][1][: len(saved)]
        assert least <= len(saved) <= least + 10
    assert len(saved) == 60


def test_damaged_bytes_are_never_taken_for_messages(tmp_path: Path) -> None:
    """A byte changed anywhere: what is saved are messages that were written, up to there."""
    file, ends = chunks_of(tmp_path, 4)
    content, rng = file.read_bytes(), np.random.default_rng(3)
    said = ends[-1][1]
    for number in range(60):
        damaged, target = tmp_path / "damaged.mcap", tmp_path / f"{number}.mcap"
        place = int(rng.integers(1000, ends[-1][0]))
        damaged.write_bytes(
            content[:place]
            + bytes([content[place] ^ int(rng.integers(1, 256))])
            + content[place + 1 :]
        )
        mend(damaged, target)
        assert all(message in said for message in by_mcap(target.read_bytes()))


def test_what_cannot_be_mended(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"no MCAP at all")
    with pytest.raises(InputError, match="allowed is an MCAP file"):
        mend(tmp_path / "x.mcap", tmp_path / "y.mcap")
    with pytest.raises(InputError, match="allowed is a new file"):
        mend(tmp_path / "x.mcap", tmp_path / "x.mcap")
