"""How well a mug is located by twelve contacts: `uv run --extra mesh python benchmarks/locating.py
[REPEATS]`, 200 by default.

A wire of 50 mm on a sensor of 2 mN and 0.04 N mm sweeps the mug's mesh from six sides, 6 mm apart:
scanned, measured, reconstructed, smoothed. Each repeat takes twelve contacts at random, turns and
moves them at random, and locates the mug from a cold start.
"""

import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import vibrissa as vb
from touching import touched

MUG = Path(__file__).parents[1] / "examples/meshes/mug.ply"
OFFSETS = 6e-3 * np.arange(-3, 4)
"""Of the sweeps from a side's middle [m]."""
CONTACTS = 12
FAR = 0.1
"""By how much the mug is moved [m]."""


def elsewhere(contacts: vb.Contacts, turn: Rotation, shift: np.ndarray) -> vb.Contacts:
    """The same contacts, turned about the origin and then moved, without what the errors of a point
    and its normal have in common: 44 of 48 ellipsoids held with it and without.
    """
    matrix = turn.as_matrix()
    return vb.Contacts(
        turn.apply(contacts.point) + shift,
        turn.apply(contacts.normal),
        matrix @ contacts.covariance @ matrix.T,
        matrix @ contacts.normal_covariance @ matrix.T,
        sweep=contacts.sweep,
    )


class Found(NamedTuple):
    """One repeat."""

    angle: float
    """By which the true pose's nearest is off [degrees]."""
    shift: float
    """[mm]"""
    stated: tuple[float, float]
    """Root mean square of both, by its covariance."""
    held: bool
    """Whether the 95 % ellipsoid holds the true pose."""
    free: bool
    """Whether a motion is left open, as a turn about the axis if the handle was not touched."""
    poses: int
    best: bool
    """Whether the nearest is the one that fits best."""
    seconds: float


def repeated(
    surface: vb.surfaces.Surface, contacts: vb.Contacts, rng: np.random.Generator
) -> Found:
    """Some of the contacts, elsewhere, and the pose found."""
    some = contacts[rng.choice(len(contacts), CONTACTS, replace=False)]
    turn, shift = Rotation.random(rng=rng), rng.uniform(-FAR, FAR, 3)
    some = elsewhere(some, turn, shift)
    start = time.perf_counter()
    found = vb.locate(surface, some)
    seconds = time.perf_counter() - start
    away = np.array([motion(found, pose, turn, shift) for pose in found.poses])
    nearest = int(np.argmin(np.linalg.norm(away[:, :3], axis=1)))
    pose, off = found.poses[nearest], away[nearest]
    free = len(pose.free) > 0
    squares = np.nan if free else off @ np.linalg.solve(pose.covariance, off)
    spread = np.sqrt([np.trace(pose.covariance[:3, :3]), np.trace(pose.covariance[3:, 3:])])
    return Found(
        float(np.degrees(np.linalg.norm(off[:3]))),
        1e3 * float(np.linalg.norm(off[3:])),
        (float(np.degrees(spread[0])), 1e3 * float(spread[1])),
        bool(squares < chi2.ppf(0.95, 6)),
        free,
        len(found.poses),
        nearest == 0,
        seconds,
    )


def motion(found: vb.Location, pose: vb.Pose, turn: Rotation, shift: np.ndarray) -> np.ndarray:
    """From a pose found to the true one, about the middle of the contacts."""
    between = turn * pose.rotation.inv()
    moved = between.apply(found.middle - pose.translation) + shift - found.middle
    return np.concatenate([between.as_rotvec(), moved])


def main(repeats: int) -> None:
    """Print how far off poses are, and how many 95 % ellipsoids hold the true one."""
    mug = vb.surfaces.Mesh.load(MUG, scale=1e-3)
    mug = mug.placed(
        Rotation.identity(), -(mug.vertices.min(axis=0) + mug.vertices.max(axis=0)) / 2
    )
    contacts = vb.Contacts.joined(touched(mug, OFFSETS, crosswise=True))
    contacts = contacts[(contacts.kind > 0) & (contacts.status == 0)]
    rng = np.random.default_rng(0)
    found = [repeated(mug, contacts, rng) for _ in range(repeats)]
    determined = [each for each in found if not each.free]
    well = [each for each in determined if each.stated[0] < 0.1 and each.stated[1] < 0.05]
    print(f"{len(contacts)} contacts, {CONTACTS} of them at a time, {repeats} times")
    for name, some in (("determined", determined), ("to 0.1°, 0.05 mm", well)):
        angle, shift = (np.array([each[column] for each in some]) for column in (0, 1))
        print(
            f"{name:<18}{len(some):>5}   off by (median, 95 %): {np.median(angle):.3f}, "
            f"{np.percentile(angle, 95):.3f}°; {np.median(shift):.3f}, "
            f"{np.percentile(shift, 95):.3f} mm; within 0.2° and 0.1 mm: "
            f"{100 * np.mean((angle < 0.2) & (shift < 0.1)):.0f} %; ellipsoids hold "
            f"{100 * np.mean([each.held for each in some]):.1f} %; best is nearest "
            f"{100 * np.mean([each.best for each in some]):.0f} %; "
            f"{np.median([each.seconds for each in some]):.2f} s"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
