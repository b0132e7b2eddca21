"""`pyarrow`, `rosbags` and their compression."""

import sys
from functools import partial
from types import ModuleType

from vibrissa.libraries import extra_library

library = partial(extra_library, extra="recordings", need="Parquet and ROS bags need it")


def zstandard() -> ModuleType:
    """Zstandard: of Python itself from 3.14 on, before that its backport."""
    return library("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")
