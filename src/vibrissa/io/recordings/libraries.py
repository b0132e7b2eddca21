"""`pyarrow`, `rosbags` and `mcap`."""

from functools import partial

from vibrissa.libraries import extra_library

library = partial(extra_library, extra="recordings", need="Parquet and ROS bags need it")
