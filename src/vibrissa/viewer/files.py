"""Files of any kind as contents of a page."""

import tomllib
from pathlib import Path

from vibrissa.files import InputError, readable, reading, text_of
from vibrissa.inverse import reconstruct
from vibrissa.io import Setup, load_case, load_setup, read_contacts, read_recording
from vibrissa.io.contacts import COLUMNS
from vibrissa.io.fitted import read_stored
from vibrissa.io.recordings.formats import BAG, TEXT, columns, kind_of
from vibrissa.io.sweeps import is_sweep, read_sweep
from vibrissa.surfaces import Surface
from vibrissa.viewer.content import Content
from vibrissa.viewer.sweeps import of_case, of_contacts, of_setup, of_shape, of_sweep

_CLOUDS = (".ply", ".vtp", ".pcd")


def of_file(file: Path, setup: Setup | None, surface: Surface | None) -> Content:
    """A scan, reconstruction, contacts, shape, recording, setup or case, by its content; the object
    is for those that know none.

    Raises
    ------
    InputError
        If the file is none of these, cannot be read, shows nothing, or is a recording without a
        setup.
    """
    try:
        return _of_file(file, setup, surface)
    except InputError:
        raise
    except (ValueError, ImportError) as error:
        raise InputError(f"{file}: {error}") from error


def _of_file(file: Path, setup: Setup | None, surface: Surface | None) -> Content:
    rod = None if setup is None else setup.rod
    suffix = file.suffix.lower()
    if suffix == ".toml":
        with reading(readable(file), "TOML"):
            tables = tomllib.loads(text_of(file))
        return of_case(load_case(file)) if "trail" in tables else of_setup(load_setup(file))
    if suffix == ".ply" and (stored := read_stored(file)) is not None:
        return of_shape(*stored, rod)
    if suffix in _CLOUDS:
        return of_contacts(read_contacts(file), surface, rod)
    kind = kind_of(file)
    if suffix == ".nc" and is_sweep(file):
        return of_sweep(read_sweep(file), surface)
    if _holds_contacts(file, kind, setup):
        return of_contacts(read_contacts(file), surface, rod)
    if setup is None:
        raise InputError(f"{file}: is a recording; allowed is one with a setup (--setup)")
    return of_sweep(reconstruct(setup.rod, read_recording(file, setup)), surface)


def _holds_contacts(file: Path, kind: str, setup: Setup | None) -> bool:
    """Whether a table or a bag holds contacts rather than a recording: a bag that may hold both,
    as a stream writes it, is a recording if there is a setup for it.
    """
    if kind == BAG:
        if file.suffix.lower() != ".mcap":
            return False
        if setup is None:
            return True
        from vibrissa.io.rosbag.clouds import only_clouds  # noqa: PLC0415

        return only_clouds(file)
    if kind == TEXT:
        header = text_of(file).partition("\n")[0]
    elif file.suffix.lower() in {".parquet", ".mat"}:
        header = ",".join(columns(file, kind, ()).names).replace("contacts.", "")
    else:
        return False
    names = {name.strip() for name in header.split(",")}
    return {"arc_length", "kind", "status"} <= names & set(COLUMNS)
