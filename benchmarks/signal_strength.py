"""Smoothing at different signal strengths: `python benchmarks/signal_strength.py [--levels 5 15 50
150 1000] [--seeds 2] [--objects ball cylinder ...]`.

One line for each object, strength (largest force over force noise) and seed: shares of true points
within the 95 % ellipsoids and median errors, raw and smoothed, over all rows that are truly in
contact and, for the coverage, OK; the share of rows that are not OK; and among those that are, the
share of gross outliers (off by more than a tenth of a rod length and ten standard deviations). A
trail fails if less than 88 % are inside, or the smoothed median is above the raw one.
"""

import argparse
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import chi2

import vibrissa as vb
from vibrissa import surfaces

RATE, SPEED, REST = 100.0, 0.01, 1.0
LEVELS = (5.0, 15.0, 50.0, 150.0, 1000.0)
ARM = 5e-3
"""Torque noise over force noise [m]: a Nano17's."""
STEEL = vb.Rod.cylinder(length=0.05, radius=0.125e-3, youngs_modulus=206e9)
UP = (0.0, 0.0, 1.0)


def _blob(point: jax.Array) -> jax.Array:
    """Two balls blended together, with a hollow between them."""
    first = jnp.linalg.norm(point - jnp.array([-0.016, 0, 0.056])) - 0.02
    second = jnp.linalg.norm(point - jnp.array([0.016, 0.004, 0.058])) - 0.022
    return -0.003 * jnp.logaddexp(-first / 0.003, -second / 0.003)


def objects() -> dict[str, tuple[surfaces.Surface, float]]:
    """Objects [m] under which the wire passes, the clamp at z = 0, and its offset from the middle
    [m].
    """
    return {
        "ball": (surfaces.Sphere((0, 0, 0.0575), 0.03), 0.004),
        "cylinder": (surfaces.Capsule((0, 0, 0.052), (0, 1, 0), 0.02, 0.015), 0.003),
        "ellipsoid": (surfaces.Ellipsoid((0, 0, 0.058), (0.02, 0.04, 0.03)), 0.006),
        "rounded box": (
            surfaces.Superquadric((0, 0, 0.06), (0.025, 0.025, 0.03), (0.4, 0.4)),
            0.005,
        ),
        "blob": (surfaces.Implicit(_blob), 0.004),
    }


class Swept(NamedTuple):
    """A scan and its trail, after a rest."""

    trail: vb.Trail
    time: np.ndarray
    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray


def swept(rod: vb.Rod, surface: surfaces.Surface, beside: float) -> Swept:
    """Sweep eighty millimetres along −x."""
    rest = round(REST * RATE)
    start = np.array([0.04, beside, 0.0])
    moving = start - np.arange(round(0.08 / SPEED * RATE))[:, None] * np.array([SPEED / RATE, 0, 0])
    scan = vb.scan(rod, surface, vb.Trail(moving))
    still = np.zeros((rest, 3))
    position = np.concatenate([np.tile(start, (rest, 1)), moving])
    force, moment = (
        np.concatenate([still, np.nan_to_num(part)])
        for part in (scan.reactions.force, scan.reactions.moment)
    )
    return Swept(
        vb.Trail(position),
        np.arange(len(position)) / RATE,
        force,
        moment,
        np.concatenate([still * np.nan, scan.point]),
    )


def measured(given: Swept, level: float, seed: int) -> vb.Reactions:
    """What a sensor without quantisation makes of it, its noise the largest force over `level`."""
    noise = float(np.linalg.norm(given.force, axis=1).max()) / level
    sensor = vb.Sensor(
        np.array([0, 0, 0.025]),
        np.array([0, 0, 0, 1.0]),
        "on_sensor",
        tare_seconds=0.95 * REST,
        force_noise=noise,
        torque_noise=ARM * noise,
        position_noise=1e-5,
    )
    true = vb.Reactions(given.trail, given.force, given.moment, time=given.time)
    return sensor.reactions(
        sensor.measure(true, np.random.default_rng(seed), force_tare=(0.4, -0.1, 1.9))
    )


class Figures(NamedTuple):
    """Figures of one trail."""

    coverage: float
    median: float
    """Median error of all rows in contact [mm]."""
    flagged: float
    gross: float


def figures(found: vb.Reconstruction, point: np.ndarray, length: float) -> Figures:
    """Compare with the true points."""
    true = np.isfinite(point[:, 0]) & found.in_contact
    sound = true & (found.status == vb.Status.OK)
    if not true.any():
        return Figures(np.nan, np.nan, 0.0, 0.0)
    assert found.covariance is not None
    error = found.point - point
    distance = np.linalg.norm(error, axis=1)
    squared = np.full(len(error), np.nan)
    squared[sound] = np.einsum(
        "ni,nij,nj->n", error[sound], np.linalg.inv(found.covariance[sound]), error[sound]
    )
    inside = squared[sound] < chi2.isf(0.05, 3)
    gross = (distance[sound] > 0.1 * length) & (squared[sound] > 100)
    return Figures(
        float(np.mean(inside)) if sound.any() else np.nan,
        1e3 * float(np.nanmedian(distance[true])),
        1 - float(sound.sum() / true.sum()),
        float(np.mean(gross)) if sound.any() else 0.0,
    )


def main(names: list[str], levels: list[float], seeds: int) -> int:
    """Print the table; return how many trails fail."""
    failed = 0
    print(
        f"{'object':12s} {'level':>6s} seed | inside raw  smooth | median raw  smooth mm | not OK  gross % | stated mm"
    )
    for name in names:
        surface, beside = objects()[name]
        scan = swept(STEEL, surface, beside)
        for level in levels:
            for seed in range(seeds):
                found = vb.reconstruct(STEEL, measured(scan, level, seed))
                smooth = vb.smooth(found)
                raw, better = (figures(part, scan.point, STEEL.length) for part in (found, smooth))
                fails = better.coverage < 0.88 or better.median > raw.median
                failed += fails
                sound = smooth.in_contact & (smooth.status == vb.Status.OK)
                assert smooth.covariance is not None
                stated = (
                    1e3 * np.median(np.sqrt(np.trace(smooth.covariance[sound], axis1=1, axis2=2)))
                    if sound.any()
                    else np.nan
                )
                print(
                    f"{name:12s} {level:6g} {seed:4d} | {raw.coverage:10.3f} {better.coverage:7.3f} | {raw.median:10.3f} {better.median:7.3f}    "
                    f"| {better.flagged:6.3f} {100 * better.gross:7.2f} | {stated:6.3f} {'FAILS' if fails else ''}",
                    flush=True,
                )
    print(f"{failed} trails fail")
    return failed


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--objects", nargs="*", default=list(objects()))
    parser.add_argument("--levels", nargs="*", type=float, default=list(LEVELS))
    parser.add_argument("--seeds", type=int, default=2)
    given = parser.parse_args()
    main(given.objects, given.levels, given.seeds)
