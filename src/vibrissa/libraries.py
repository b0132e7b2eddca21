"""Libraries that come with extras: loaded when first needed."""

import importlib
from types import ModuleType


def extra_library(name: str, *, extra: str, need: str) -> ModuleType:
    """Import a module of a library that an extra installs.

    Parameters
    ----------
    name
        Of the module.
    extra
        As in `vibrissa[extra]`.
    need
        What cannot be done without it, in words: "meshes need it".

    Raises
    ------
    ImportError
        If it is not installed; the text names the command that does it.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = error.name or name
        raise ImportError(
            f"{missing} is not installed; {need}: python3 -m pip install 'vibrissa[{extra}]'",
            name=missing,
        ) from error
