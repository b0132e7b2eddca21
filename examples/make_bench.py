"""The bench's logs as a laboratory would hand them over: `python examples/make_bench.py FOLDER`.

FOLDER holds logs of the independent engine as `benchmarks/bench_recordings.py` makes them, one row
for wrench and pose at 250 Hz: `NAME.csv` or `NAME.csv.gz`. Here the force/torque sensor and the
robot get their own files, rates, names and units; no number is changed but by its unit.
"""

import sys
from pathlib import Path

import pandas as pd

FOLDER = Path(__file__).parent / "bench"
SOURCES = {
    "ball_1": "trail_y-0.20.csv",
    "ball_2": "trail_y+0.30.csv",
    "bar_1": "cyl_s3.csv.gz",
    "bar_2": "cylobl.csv.gz",
}
EVERY = 2
"""The robot logs at half the sensor's rate."""


def main(logs: Path, folder: Path = FOLDER) -> None:
    """Write two files for each log."""
    for name, source in SOURCES.items():
        log = pd.read_csv(next(logs.rglob(source)))
        log = log[: len(log) - (len(log) - 1) % EVERY]  # up to the last pose
        wrench = pd.DataFrame({"t_ms": 1e3 * log["time"]})
        for axis in "xyz":
            wrench[f"F{axis} (N)"] = log[f"f{axis}"]
        for axis in "xyz":
            wrench[f"T{axis} (Nmm)"] = 1e3 * log[f"t{axis}"]
        wrench.round(5).to_csv(folder / f"{name}.csv", sep=";", index=False)
        pose = pd.DataFrame({"t_ms": 1e3 * log["time"]})
        for axis in "xyz":
            pose[f"{axis} (mm)"] = 1e3 * log[f"p{axis}"]
        for part in "wxyz":
            pose[f"q{part}"] = log[f"q{part}"]
        pose[::EVERY].round(9).to_csv(folder / f"{name}_robot.csv", index=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
