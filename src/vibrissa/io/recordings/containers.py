"""The files of a bag: a folder of rosbag2 with its metadata, MCAP, SQLite, and all of them packed
by Zstandard.
"""

import tempfile
from pathlib import Path, PurePath
from typing import Any

from vibrissa.files import InputError
from vibrissa.io.recordings import mcap
from vibrissa.io.recordings.arrays import reading
from vibrissa.io.recordings.libraries import library
from vibrissa.io.recordings.messages import KINDS, Bag, Message

_ZSTD = b"\x28\xb5\x2f\xfd"
_SQLITE = b"SQLite format 3\0"


def bag_of(path: Path) -> Bag:
    """All messages of a bag: a folder of rosbag2, or one of its files, also without its metadata.

    Raises
    ------
    InputError
        If the bag has no files, or one is damaged from its start.
    """
    bag = Bag()
    metadata = _metadata(path, bag) if path.is_dir() else {}
    packed = str(metadata.get("compression_mode", "")).lower() == "message"
    for file in _files(path, metadata, bag):
        first = len(bag.messages)
        _read(file, file, bag)
        if packed:
            with reading(file, "Zstandard"):
                bag.messages[first:] = [
                    message._replace(data=mcap.unpacked_zstd(message.data))
                    for message in bag.messages[first:]
                ]
    return bag


def is_bag(folder: Path) -> bool:
    """Whether a folder holds a bag, with or without its metadata."""
    return (folder / "metadata.yaml").exists() or bool(_storage(folder))


def _storage(folder: Path) -> list[Path]:
    patterns = ("*.mcap", "*.db3", "*.mcap.zstd", "*.db3.zstd")
    found = [file for pattern in patterns for file in folder.glob(pattern)]
    return sorted(found, key=lambda file: (len(file.name), file.name))


def _metadata(path: Path, bag: Bag) -> dict[str, Any]:
    file, state = path / "metadata.yaml", "missing, as where a recorder was killed"
    if file.is_file():
        yaml, state = library("ruamel.yaml").YAML(typ="safe", pure=True), "damaged"
        try:
            return dict(yaml.load(file.read_text("utf-8"))["rosbag2_bagfile_information"])
        # YAML of any kind, or none: the files beside it still say what they hold.
        except Exception:
            pass
    bag.notes.append(f"{path.name}: metadata.yaml is {state}; the bag's files are read as they are")
    return {}


def _files(path: Path, metadata: dict[str, Any], bag: Bag) -> list[Path]:
    if not path.is_dir():
        return [path]
    listed = [path / PurePath(str(name)).name for name in metadata.get("relative_file_paths") or ()]
    missing = [file.name for file in listed if not file.is_file()]
    if missing:
        bag.notes.append(
            f"{path.name}: {len(missing)} of the {len(listed)} files of the bag are missing, "
            f"first {missing[0]!r}"
        )
    present = [file for file in listed if file.is_file()] or _storage(path)
    if not present:
        raise InputError(f"{path}: a bag without its .mcap or .db3 files; allowed is a whole bag")
    return present


def _read(file: Path, plain: Path, bag: Bag) -> None:
    """Add the messages of a file; `plain` is where it lies unpacked."""
    with plain.open("rb") as opened:
        start = opened.read(len(_SQLITE))
    if start.startswith(mcap.MAGIC):
        mcap.read(plain, bag)
    elif start == _SQLITE:
        _read_sqlite(file, plain, bag)
    elif start.startswith(_ZSTD) and file == plain:
        with tempfile.TemporaryDirectory() as folder:
            unpacked = Path(folder) / file.stem
            codec = library("zstandard").ZstdDecompressor()
            with reading(file, "Zstandard"), file.open("rb") as packed, unpacked.open("wb") as out:
                codec.copy_stream(packed, out)
            _read(file, unpacked, bag)
    else:
        raise InputError(f"{file}: begins with {start[:8]!r}; allowed are bags of MCAP or SQLite")


def _read_sqlite(file: Path, plain: Path, bag: Bag) -> None:
    before = len(bag.messages)
    try:
        with reading(file, "SQLite"):
            reader = library("rosbags.rosbag2").Reader.STORAGE_PLUGINS[".db3"](plain)
            reader.open()
            topics = {one.topic: one.msgtype for one in reader.connections}
            bag.topics.update(topics)
            chosen = [one for one in reader.connections if one.msgtype in KINDS]
            for one, time, data in reader.messages(chosen) if chosen else ():
                bag.messages.append(Message(one.topic, int(time), bytes(data)))
            reader.close()
    # SQLite finds damage where it comes to it: what was read before it counts.
    except InputError as error:
        count = len(bag.messages) - before
        if not count:
            raise
        bag.notes.append(f"{error}; recovered are {count} messages of wrenches and poses")
