"""The mesh libraries, an extra: loaded when first needed."""

import importlib
from types import ModuleType


def library(name: str) -> ModuleType:
    """Import `trimesh` or `igl`.

    Raises
    ------
    ImportError
        If it is not installed; the text names the command that does it.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"{error.name} is not installed; meshes need it: python3 -m pip install 'vibrissa[mesh]'", name=error.name
        ) from error
