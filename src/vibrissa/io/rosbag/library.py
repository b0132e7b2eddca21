"""`mcap` and `rosbags`, for writing."""

from functools import partial

from vibrissa.libraries import extra_library

library = partial(extra_library, extra="live", need="MCAP needs it")
