"""The libraries for MCAP and ROS 2 messages, an extra: loaded when first needed."""

import importlib
from types import ModuleType


def library(name: str) -> ModuleType:
    """Import a module of `mcap` or `rosbags`.

    Raises
    ------
    ImportError
        If it is not installed; the text names the command that does it.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"{error.name} is not installed; MCAP needs it: python3 -m pip install 'vibrissa[live]'", name=error.name
        ) from error
