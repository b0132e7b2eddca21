"""The libraries for tables and bags, an extra: loaded when first needed."""

import importlib
import sys
from types import ModuleType


def library(name: str) -> ModuleType:
    """Import a module of `pyarrow`, `rosbags`, `lz4` or `backports.zstd`.

    Raises
    ------
    ImportError
        If it is not installed; the text names the command that does it.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"{error.name} is not installed; Parquet and ROS bags need it: python3 -m pip install 'vibrissa[recordings]'", name=error.name
        ) from error


def zstandard() -> ModuleType:
    """Zstandard: of Python itself from 3.14 on, before that its backport."""
    return library("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")
