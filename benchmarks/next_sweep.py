"""How many sweeps it takes to know an object: `uv run --extra mesh python benchmarks/next_sweep.py
[STARTS] [--oracle]`, 12 starts by default.

Of 54 parallel lines from six sides, 30 of which touch a rounded block, one is known; `next_sweep`,
chance and an interleaved raster choose others until 95 % of the block is within 2 mm of the surface.
Contacts come from the whole chain: a wire of 50 mm on a sensor of 2 mN and 0.04 N mm. The oracle
sees the truth: it fits a surface for each line that is left, and takes the one that helps most,
which takes minutes for each start.
"""

import sys
import time
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

import vibrissa as vb
from touching import AWAY, RATE, REACH, SENSOR, WIRE
from vibrissa.shape.area import points_over

BLOCK = vb.surfaces.Offset(
    vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.018, 0.012, 0.015)), 0.003
)
OFFSETS = 6e-3 * np.arange(-4, 5)
"""Of a side's lines from its middle [m]."""
WITHIN, KNOWN, MOST = 2e-3, 0.95, 54
"""Distance [m] within which a share of the truth is to be known, and sweeps at most."""


def lines() -> vb.Trail:
    """Side by side, from each of six sides."""
    sides = [Rotation.from_euler("x", 90 * i, degrees=True) for i in range(4)]
    sides += [Rotation.from_euler("y", angle, degrees=True) for angle in (90, -90)]
    return vb.Trail.stack(
        [
            vb.Trail(
                side.apply([[REACH, offset, -AWAY], [-REACH, offset, -AWAY]]),
                np.tile(side.as_quat(), (2, 1)),
            )
            for side in sides
            for offset in OFFSETS
        ]
    )


def interleaved() -> list[int]:
    """A raster of all sides in turn, its lines ever closer."""
    return [9 * side + line for line in (4, 0, 8, 2, 6, 1, 3, 5, 7) for side in range(6)]


class World:
    """What each line would find, and points spread evenly over the truth."""

    def __init__(self) -> None:
        """Sweep all lines."""
        self.lines = lines()
        arm = vb.SimulatedArm(WIRE, BLOCK, SENSOR, rate=RATE, rng=np.random.default_rng(0))
        self.found = [arm(self.lines[row]).contacts for row in range(self.lines.shape[0])]
        sound = [int(np.sum((each.kind > 0) & (each.status == 0))) for each in self.found]
        self.touching = np.flatnonzero(np.array(sound) > 5)
        rng, near = np.random.default_rng(1), np.zeros((1, 3))
        self.truth = points_over(BLOCK, near, 0.1, 0.1, 1500, rng, said="block")

    def shape(self, rows: list[int]) -> vb.Shape:
        """Through the contacts of some lines."""
        return vb.fit_shape([self.found[row] for row in rows])

    def known(self, shape: vb.Shape) -> float:
        """Share of the truth that is within 2 mm of a surface."""
        away = np.linalg.norm(shape.nearest(self.truth) - self.truth, axis=1)
        return float(np.mean(away < WITHIN))

    def sweeps(self, rows: list[int], choose: Iterator[int] | None, seconds: list[float]) -> int:
        """How many it takes, those of `choose` or else the planner's."""
        shape = self.shape(rows)
        while self.known(shape) < KNOWN and len(rows) < MOST:
            left = np.setdiff1d(np.arange(len(self.found)), rows)
            if choose is None:
                start = time.perf_counter()
                ranked = vb.next_sweep(shape, WIRE, self.lines[left], tolerance=WITHIN)
                seconds.append(time.perf_counter() - start)
                rows = [*rows, int(left[ranked.order[0]])]
            else:
                rows = [*rows, next(row for row in choose if row not in rows)]
            shape = self.shape(rows)
        return len(rows)

    def best(self, rows: list[int]) -> int:
        """How many an oracle takes."""
        while self.known(self.shape(rows)) < KNOWN:
            left = [int(row) for row in self.touching if row not in rows]
            helped = [self.known(self.shape([*rows, row])) for row in left]
            rows = [*rows, left[int(np.argmax(helped))]]
        return len(rows)


def main(starts: int, *, oracle: bool) -> None:
    """Print how many sweeps each way of choosing takes, the first included."""
    world, seconds, taken = World(), list[float](), list[list[int]]()
    every = np.arange(len(world.found))
    print(f"{len(world.touching)} of {len(every)} lines touch")
    names = ["planned", "chance", "raster", "chance, touching", "raster, touching"]
    for seed in range(starts):
        first = [int(np.random.default_rng(100 + seed).choice(world.touching))]
        rng = np.random.default_rng(seed)
        raster = [row for row in interleaved() if row in world.touching]
        orders = rng.permutation(every), interleaved(), rng.permutation(world.touching), raster
        row = [world.sweeps(first, None, seconds)]
        row += [world.sweeps(first, iter([int(one) for one in order]), []) for order in orders]
        taken.append(row + [world.best(first)] * oracle)
        print(*taken[-1], flush=True)
    for name, mean in zip([*names, "oracle"], np.mean(taken, axis=0), strict=False):
        print(f"{name:<18}{mean:>6.2f} sweeps")
    print(f"a choice takes {np.median(seconds):.2f} s, at most {np.max(seconds):.2f} s")


if __name__ == "__main__":
    numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
    main(*(numbers or [12]), oracle="--oracle" in sys.argv)
