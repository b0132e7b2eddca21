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
