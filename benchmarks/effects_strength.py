"""Smoothing over the strength of the signal: `python benchmarks/effects_strength.py [--scenes NAME ...] [--strengths NUMBER ...] [--made FOLDER]`.

Runs of the independent engine are logged by sensors whose stated noise is the largest force over the strength (torques: the same share of force times half the
rod's length). Everything is as stated. To hold: true points inside the 95 % ellipsoids of rows that say OK, 88 % of each sweep; a median error that is not
above that of the samples one by one; gross outliers at most 0.3 %.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import vibrissa as vb
from bench_recordings import SCENES as ALL
from bench_recordings import Recording, made, run_of
from effects import CACHE, Row, judge
from engine import remembered
from logs import Sensor

SCENES = ("ball5", "oblique", "ellipsoid", "blob")
STRENGTHS = (5.0, 15.0, 50.0, 150.0, 1000.0)
SEEDS = 2


def sensor_of(scene: str, strength: float, made_in: Path) -> Sensor:
    """A sensor whose noise is that share of the scene's largest force, with steps as fine as those of the usual one."""
    run = remembered(made_in / "runs" / f"{scene}.npz", lambda: run_of(ALL[scene]))
    force = float(np.linalg.norm(run.force, axis=1).max() / strength)
    torque = force * ALL[scene].wire.length / 2
    return Sensor(force_noise=force, torque_noise=torque, force_step=0.8 * force, torque_step=0.2 * torque)


def main(scenes: list[str], strengths: list[float], seeds: int, made_in: Path) -> list[tuple[Row, Row]]:
    """Print and return a line a sweep: raw and smoothed."""
    print(f"{'':<26}{'error, mm':>20}{'stated, mm':>20}{'inside OK, %':>18}{'OK, %':>14}{'gross, %':>10}{'missed, %':>12}")
    print(f"{'':<26}" + "".join(f"{'raw':>{width}}{'smooth':>9}" for width in (11, 11, 9, 5)))
    rows = []
    with TemporaryDirectory() as folder:
        for scene in scenes:
            for strength in strengths:
                recording = replace(Recording(scene), sensor=sensor_of(scene, strength, made_in))
                for seed in range(seeds):
                    rows.append(pair_of(recording, strength, seed, made_in, Path(folder)))
                    print(text_of(*rows[-1]), flush=True)
    return rows


def pair_of(recording: Recording, strength: float, seed: int, made_in: Path, folder: Path) -> tuple[Row, Row]:
    """Figures of one sweep, raw and smoothed."""
    log = made(recording, made_in / "runs", seed)
    log.write(folder, "sweep")
    raw, smooth = (Row(f"{recording.scene} {strength:g} {seed}", kind, "", "") for kind in ("raw", "smoothed"))
    try:
        setup = vb.load_setup(folder / "sweep.toml")
        found = vb.reconstruct(setup.rod, vb.read_recording(folder / "sweep.csv", setup))
        judge(raw, found, log.point)
        smoothed = vb.smooth(found)
        judge(smooth, smoothed, log.point)
        smooth.said += " | ".join(line[:80] for line in getattr(smoothed, "warnings", []))
    except Exception as error:
        smooth.said += f"{type(error).__name__}: {error}"[:100]
    return raw, smooth


def text_of(raw: Row, smooth: Row) -> str:
    """One line."""
    pairs = [(name, digits) for name, digits in (("error", 3), ("deviation", 3), ("inside_ok", 0), ("ok", 0))]
    figures = "".join(
        f"{getattr(raw, name):>{11 if digits else 9}.{digits}f}{getattr(smooth, name):>9.{digits}f}" for name, digits in pairs
    )
    return f"{smooth.name:<26}{figures}{smooth.gross:>10.1f}{smooth.missed:>12.0f}  {smooth.said}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--strengths", type=float, nargs="+", default=list(STRENGTHS))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--made", type=Path, default=CACHE)
    given = parser.parse_args()
    main(given.scenes, given.strengths, given.seeds, given.made)
