"""Good files of an experiment, small and made up, for tests that read them as they are or damage
them.
"""

import numpy as np

SETUP = """\
[rod]
kind = "cylinder"
length = 0.05
radius = 0.25e-3
youngs_modulus = 206e9

[sensor]
clamp_position = [0.001, 0.002, 0.025]
clamp_orientation = [0.0, 0.0, 0.0, 1.0]
wrench = "on_sensor"
wrench_frame = "sensor"
wrench_point = [0.0, 0.0, 0.001]
tare_seconds = 0.85
force_noise = 2.0e-3
torque_noise = 4.0e-5
force_resolution = 1.5625e-3
torque_resolution = 7.8125e-6
position_noise = 1.0e-5

[object]
kind = "sphere"
radius = 0.03
center = [0.0, 0.0, 0.0575]
"""

CASE = """\
[rod]
kind = "uniform"
length = 0.05
bending_stiffness = 6.3e-4

[object]
kind = "ellipsoid"
center = [0.0, 0.0, 0.0575]
semi_axes = [0.03, 0.02, 0.03]
rotation = [0.0, 0.0, 0.6, 0.8]
translation = [0.001, 0.0, 0.0]

[[trail]]
kind = "line"
start = [0.04, 0.005, 0.0]
stop = [-0.04, 0.005, 0.0]
count = 9

[[trail]]
kind = "poses"
position = [[0.04, 0.0, 0.0], [0.03, 0.0, 0.0], [0.02, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.0, 0.0],
  [-0.01, 0.0, 0.0], [-0.02, 0.0, 0.0], [-0.03, 0.0, 0.0], [-0.04, 0.0, 0.0]]
orientation = [[0.0, 0.6, 0.0, 0.8]]
"""

HEADER = "time,px,py,pz,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz"
ROWS, TARE_ROWS = 40, 10
PAUSE = slice(25, 30)


def recording_table(rows: int = ROWS, pause: slice = PAUSE) -> np.ndarray:
    """Ten rows a second, free of contact for the first, then pushed with up to 1 N at the wire's
    tip, with a pause so that neither push is long enough for the clamp's work to be held against
    the rod's energy; columns as HEADER.
    """
    table = np.zeros((rows, 14))
    table[:, 0] = 0.05 + 0.1 * np.arange(rows)
    table[:, 1] = 0.04 - 1e-3 * np.arange(rows)
    table[:, 2] = 0.005
    table[:, 6:8] = 0.6, 0.8
    load = np.clip(np.arange(rows) - TARE_ROWS + 1, 0, None) / (rows - TARE_ROWS)
    load[pause] = 0
    force = load[:, None] * [0.3, -0.2, -0.8]
    table[:, 8:11] = [0.3125, -0.125, 1.9375] + force
    table[:, 11:14] = [2.0e-3, -4.0e-3, 7.0e-4] + np.cross([0.012, 0.004, 0.065], force)
    return table


def recording_text(table: np.ndarray) -> str:
    """CSV with as many decimals as such logs have."""
    decimals = (4, 6, 6, 6, 9, 9, 9, 9, 5, 5, 5, 7, 7, 7)
    lines = [
        ",".join(f"{value:.{digits}f}" for value, digits in zip(row, decimals, strict=True))
        for row in table
    ]
    return "\n".join([HEADER, *lines]) + "\n"


RECORDING = recording_text(recording_table())
ONE_PUSH = recording_text(recording_table(pause=slice(0)))
