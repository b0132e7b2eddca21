"""What is wrong with a file, in one line."""

from pathlib import Path

from vibrissa.files import InputError, readable

__all__ = ["InputError", "readable", "writable", "writable_folder"]


def writable(path: Path) -> Path:
    """Return the path of a file to be written, its folder made if need be; raise InputError where
    that cannot be.
    """
    _folder(path.parent)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; allowed is a file")
    _probe(path.parent)
    return path


def writable_folder(path: Path) -> Path:
    """Return the path of a folder to write into, made if need be; raise InputError where that
    cannot be.
    """
    _folder(path)
    _probe(path)
    return path


def _folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{path}: the output folder cannot be made ({error.strerror or error}); allowed is a folder that can be written to"
        ) from error


def _probe(path: Path) -> None:
    probe = path / ".vibrissa-write-test"
    try:
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(
            f"{path}: the output folder is not writable ({error.strerror or error}); allowed is a folder that can be written to"
        ) from error
