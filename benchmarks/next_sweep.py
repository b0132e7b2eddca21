"""How many sweeps it takes until 95 % of an object is known within 2 mm: `uv run --extra mesh python
benchmarks/next_sweep.py OBJECT [POLICY ...]`; OBJECT is block, ellipsoid or blob, each POLICY the
title of a row. All rows take some 40 minutes.

From each of eight random first sweeps, the next is chosen from the same hundred random lines, all of
which touch the object: by `vb.next_sweep`, with the tolerance of 2 mm or without; by an oracle,
which expects of each line what `next_sweep` would if it knew where the contacts will be; or by
chance. A raster has lines of its own, from six sides in turn, in two directions, from the middle
outwards. After each sweep the surface is fitted to the smoothed contacts so far.
"""

import sys
import time
from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

import vibrissa as vb
from shape_accuracy import OBJECTS as FIVE
from surfaces import spread
from touching import AWAY, RATE, REACH, SENSOR, WIRE
from vibrissa.shape.plan import _ending, _Planned

OBJECTS: dict[str, vb.surfaces.Surface] = {
    "block": vb.surfaces.Offset(
        vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.018, 0.012, 0.015)), 0.003
    ),
    "ellipsoid": FIVE["ellipsoid"],
    "blob": FIVE["concave blob"],
}
LINES, STARTS, LEAST = 100, 8, 20
"""Lines to choose from, first sweeps, and contacts that make a line one that touches."""
NEAREST, FARTHEST, ASIDE = 0.042, 0.060, 0.015
"""Of random lines: distances of the clamp from the object's middle, and of the plane in which the
rod moves, at most [m].
"""
WITHIN, SHARE, MOST = 2e-3, 0.95, 40
"""Distance within which a place is known [m], share that is to be known, and sweeps to give up after."""


class World:
    """An object, lines along it, and what was felt there."""

    def __init__(self, surface: vb.surfaces.Surface) -> None:
        """Draw the lines."""
        self.arm = vb.SimulatedArm(WIRE, surface, SENSOR, rate=RATE, rng=np.random.default_rng(0))
        self.truth = spread(surface)
        self.lines = self._random()
        self.raster = self._raster()

    @cache  # noqa: B019 - lives as long as the program
    def felt(self, line: int, *, raster: bool = False) -> vb.Contacts:
        """Smoothed contacts along a line."""
        return self.arm((self.raster if raster else self.lines)[line]).contacts

    def _line(self, turned: Rotation, away: float, aside: float) -> vb.Trail:
        ends = turned.apply([[-REACH, aside, -away], [REACH, aside, -away]])
        return vb.Trail(ends, np.tile(turned.as_quat(), (2, 1)))

    def _random(self) -> vb.Trail:
        rng, lines = np.random.default_rng(1), list[vb.Trail]()
        while len(lines) < LINES:
            turned = Rotation.random(rng=rng)
            away, aside = rng.uniform(NEAREST, FARTHEST), rng.uniform(-ASIDE, ASIDE)
            line = self._line(turned, away, aside)
            if self.arm.surface.distances(line.position).min() < 0:
                continue
            contacts = self.arm(line).contacts
            if np.sum((contacts.kind > 0) & (contacts.status == 0)) >= LEAST:
                lines.append(line)
        return vb.Trail.stack(lines)

    def _raster(self) -> vb.Trail:
        sides = [Rotation.from_euler("x", 90 * i, degrees=True) for i in range(4)]
        sides += [Rotation.from_euler("y", angle, degrees=True) for angle in (90, -90)]
        quarter = Rotation.from_euler("z", 90, degrees=True)
        aside = 1e-3 * np.array([0, 10, -10, 5, -5, 14, -14])
        return vb.Trail.stack(
            [
                self._line(turned, AWAY, each)
                for each in aside
                for number in (0, 1)
                for turned in (side * quarter**number for side in sides)
            ]
        )


Policy = Callable[[World, vb.Shape, list[int], np.random.Generator], int]
"""The next of the lines that are left."""


def planned(tolerance: float | None) -> Policy:
    """As `vb.next_sweep` does."""

    def choose(world: World, shape: vb.Shape, left: list[int], _: np.random.Generator) -> int:
        lines = vb.Trail(world.lines.position[left], world.lines.orientation[left])
        return left[vb.next_sweep(shape, WIRE, lines, tolerance=tolerance).order[0]]

    return choose


def oracle(tolerance: float | None) -> Policy:
    """As `vb.next_sweep` would if it knew where the contacts will be."""

    def choose(world: World, shape: vb.Shape, left: list[int], _: np.random.Generator) -> int:
        gains = _Planned.of(_ending(shape), tolerance).gains
        found = [world.felt(line) for line in left]
        sound = [np.asarray((each.kind > 0) & (each.status == 0)) for each in found]
        points = [each.point[rows] for each, rows in zip(found, sound, strict=True)]
        return left[int(np.argmax(gains.expected(points)))]

    return choose


def chance(_: World, __: vb.Shape, left: list[int], rng: np.random.Generator) -> int:
    """Any."""
    return int(rng.choice(left))


POLICIES: dict[str, Policy | None] = {
    "planned, 2 mm": planned(WITHIN),
    "planned": planned(None),
    "oracle, 2 mm": oracle(WITHIN),
    "oracle": oracle(None),
    "chance": chance,
    "raster": None,
}


def sweeps(world: World, policy: Policy | None, start: int) -> tuple[int, list[float]]:
    """How many it takes, the first included, and seconds of the choices."""
    rng, seconds = np.random.default_rng(start), list[float]()
    raster = policy is None
    count = world.raster.shape[0] if raster else LINES
    first = start if raster else int(rng.integers(count))
    driven, left = [first], [line for line in range(count) if line != first]
    for number in range(1, MOST):
        try:
            shape = vb.fit_shape([world.felt(line, raster=raster) for line in driven])
        except ValueError:  # of a raster, whose first lines may miss
            known = 0.0
        else:
            known = np.mean(np.abs(shape.distance(world.truth)) < WITHIN)
        if known >= SHARE:
            return number, seconds
        if raster:
            driven.append((start + number) % count)
            continue
        begin = time.perf_counter()
        driven.append(policy(world, shape, left, rng))
        seconds.append(time.perf_counter() - begin)
        left.remove(driven[-1])
    return MOST, seconds


def main(name: str, names: list[str]) -> None:
    """Print a row for each policy."""
    world = World(OBJECTS[name])
    print(
        f"{'sweeps':<16}{'mean':>7}{'error':>7}{'median':>8}{'most':>6}{'s a choice':>12}",
        flush=True,
    )
    for title, policy in POLICIES.items():
        if names and title not in names:
            continue
        counts, seconds = [], list[float]()
        for start in range(STARTS):
            count, took = sweeps(world, policy, start)
            counts.append(count)
            seconds += took
        error = np.std(counts, ddof=1) / np.sqrt(STARTS)
        print(
            f"{title:<16}{np.mean(counts):>7.1f}{error:>7.1f}{np.median(counts):>8.1f}"
            f"{np.max(counts):>6}{np.median(seconds or [np.nan]):>12.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
