"""Files and folders to be written: what is wrong with one, in one line."""

from pathlib import Path

from vibrissa.files import InputError, readable

__all__ = ["InputError", "readable", "writable", "writable_folder"]


def writable(path: Path) -> Path:
    """Return the path of a file to be written, its folder made if need be; raise InputError where
    that cannot be.
    """
    writable_folder(path.parent)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; allowed is a file")
    return path


def writable_folder(path: Path) -> Path:
    """Return the path of a folder to write into, made if need be; raise InputError where that
    cannot be.
    """
    wrong = "cannot be made"
    try:
        path.mkdir(parents=True, exist_ok=True)
        wrong = "is not writable"
        probe = path / ".vibrissa-write-test"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(
            f"{path}: the output folder {wrong} ({error.strerror or error}); "
            "allowed is a folder that can be written to"
        ) from error
    return path
