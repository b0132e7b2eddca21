"""Libraries of optional extras, imported when first needed."""

import importlib
from types import ModuleType


def extra_library(name: str, *, extra: str, need: str) -> ModuleType:
    """Import a module that an extra installs.

    Parameters
    ----------
    name
        The module's name.
    extra
        As in `vibrissa[extra]`.
    need
        What needs it, in words: "meshes need it".

    Raises
    ------
    ImportError
        If it is not installed; the message gives the install command.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = error.name or name
        raise ImportError(
            f"{missing} is not installed; {need}: python3 -m pip install 'vibrissa[{extra}]'",
            name=missing,
        ) from error


_WRITERS = {
    ".parquet": ("pyarrow", "recordings", "Parquet needs it"),
    ".pcd": ("pypcd4", "recordings", ".pcd needs it"),
    ".mcap": ("mcap.records", "live", "MCAP needs it"),
}


def writer(suffix: str) -> None:
    """Import what writing a file of this suffix needs, so that one that is not installed is
    reported before anyone waits; raise ImportError as above.
    """
    if suffix in _WRITERS:
        name, extra, need = _WRITERS[suffix]
        extra_library(name, extra=extra, need=need)
