"""Sweeps of wires that taper, are bent at rest or have weight, by an independent engine, and what
becomes of their contacts with the rod as it is and with a plain one.

    python tests/recordings/engine_rods.py           # prints the table of docs/real_rods.md
    python tests/recordings/engine_rods.py --make    # runs the engine anew, writes engine_rods.npz

The engine is MuJoCo (dependency group `benchmark`): a chain of links with bending and twisting
springs, stepped to rest at each pose (`benchmarks/engine.py`). The file has the exact force, moment
and contact of each pose of the clamp.
"""

import sys
import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

import vibrissa as vb
from vibrissa.sensor import RawRecording

STEEL, DENSITY, GRAVITY = 206e9, 7850.0, 9.80665
RATE, REST = 50.0, 100
"""Samples per second, and samples at rest before the sweep."""
INSIDE = chi2.isf(0.05, 3)
SEGMENTS = 72
_FILE = Path(__file__).with_suffix(".npz")


@dataclass(frozen=True)
class Scene:
    """A wire as `benchmarks/engine.py` describes it, SI units; a ball, and the way of the clamp."""

    wire: dict[str, Any]
    center: tuple[float, float, float]
    radius: float
    start: tuple[float, float, float]
    stop: tuple[float, float, float]
    count: int

    @property
    def trail(self) -> vb.Trail:
        """Of the clamp."""
        position = np.linspace(self.start, self.stop, self.count)
        return vb.Trail(position, np.tile([0.0, 0.0, 0.0, 1.0], (self.count, 1)))

    @property
    def rod(self) -> vb.Rod:
        """The wire as it is. The engine's has the same curvature all along, 8 b/L² for a sagitta b."""
        wire = self.wire
        size = {name: wire[name] for name in ("length", "youngs_modulus")}
        size |= {name: wire[name] for name in ("density",) if name in wire}
        tip = wire.get("tip", 1.0) * wire["radius"]
        rod = vb.Rod.tapered(base_radius=wire["radius"], tip_radius=tip, **size)
        if "sagitta" in wire:
            b, roll = np.hypot(*wire["sagitta"]), np.arctan2(*wire["sagitta"][::-1])
            rod = rod.curved(vb.RestShape.arc(wire["length"] ** 2 / (8 * b), roll))
        if "down" in wire:
            rod = rod.loaded(vb.Loads(gravity=GRAVITY * np.array(wire["down"])))
        return rod

    @property
    def plain(self) -> vb.Rod:
        """What one would take it for: straight, weightless, as thick all along as at the clamp."""
        wire = self.wire
        return vb.Rod.cylinder(
            length=wire["length"], radius=wire["radius"], youngs_modulus=wire["youngs_modulus"]
        )


_WIRE = {"length": 0.05, "radius": 0.25e-3, "youngs_modulus": STEEL, "poisson_ratio": 0.3}
_ROLL = np.array([np.cos(0.7), np.sin(0.7)])
_BALL = {"center": (0.0, 0.0, 0.0575), "radius": 0.03}
SCENES = {
    "straight": Scene(
        _WIRE, **_BALL, start=(0.036, 0.005, 0.0), stop=(-0.036, 0.005, 0.0), count=181
    ),
    "tapered": Scene(
        _WIRE | {"tip": 0.5},
        **_BALL,
        start=(0.036, 0.005, 0.0),
        stop=(-0.036, 0.005, 0.0),
        count=181,
    ),
    "curved": Scene(
        _WIRE | {"tip": 0.5, "sagitta": tuple(1e-3 * _ROLL)},
        **_BALL,
        start=(0.036, 0.008, 0.0),
        stop=(-0.04, 0.008, 0.0),
        count=191,
    ),
    "heavy": Scene(
        _WIRE | {"length": 0.12, "radius": 0.1e-3, "density": DENSITY, "down": (0.0, -1.0, 0.0)},
        center=(0.0, 0.0, 0.138),
        radius=0.06,
        start=(0.09, 0.012, 0.0),
        stop=(-0.09, 0.012, 0.0),
        count=181,
    ),
    "whisker": Scene(
        {
            "length": 0.04,
            "radius": 0.1e-3,
            "youngs_modulus": 3.3e9,
            "poisson_ratio": 0.3,
            "tip": 0.3,
            "sagitta": tuple(1.2e-3 * _ROLL),
            "density": 1400.0,
            "down": (0.0, -1.0, 0.0),
        },
        center=(0.0, 0.0, 0.046),
        radius=0.024,
        start=(0.03, 0.006, 0.0),
        stop=(-0.03, 0.006, 0.0),
        count=151,
    ),
}


class Sweep(NamedTuple):
    """One sweep of the engine: what the clamp exerts on the rod and the contact point (n, 3), NaN
    without contact; the clamp's axes are the world's.
    """

    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray


class Judged(NamedTuple):
    """Contacts against the engine's, over all rows in contact but the first and last twentieth.

    Attributes
    ----------
    raw, smooth
        Median distance from the true contact, sample by sample and smoothed [% of the length].
    inside
        Share of the true contacts within the 95 % ellipsoids of the smoothed ones [%].
    ok_raw, ok
        Share of rows whose status is OK [%].
    said
        Warnings.
    found, smoothed
        The contacts.
    """

    raw: float
    smooth: float
    inside: float
    ok_raw: float
    ok: float
    said: tuple[str, ...]
    found: vb.Reconstruction
    smoothed: vb.Reconstruction


@cache
def loaded(name: str) -> Sweep:
    """The engine's sweep of a scene."""
    with np.load(_FILE) as file:
        return Sweep(*file[name].astype(float).reshape(-1, 3, 3).transpose(1, 0, 2))


def logged(name: str, seed: int) -> RawRecording:
    """The sweep as a sensor logs it, after two seconds at rest."""
    scene, sweep = SCENES[name], loaded(name)
    rows = np.maximum(np.arange(REST + scene.count) - REST, 0)
    time = np.arange(len(rows)) / RATE
    true = vb.Reactions(scene.trail[rows], sweep.force[rows], sweep.moment[rows], time=time)
    zero = {"force_tare": (0.3, -0.1, 1.9), "torque_tare": (2e-3, -4e-3, 1e-3)}
    return sensor(name).measure(true, np.random.default_rng(seed), **zero)


def sensor(name: str) -> vb.Sensor:
    """2 mN and 0.04 N mm for the steel wires of half a millimetre; for the softer ones as large
    against EI/L² and EI/L as in `tests/roundtrip/test_real_rods_smoothed.py`.
    """
    rod = SCENES[name].plain
    weak = rod.force_scale < 0.1
    return vb.Sensor(
        np.array([0.0, 0.0, 0.025]),
        np.array([0.0, 0.0, 0.0, 1.0]),
        "on_sensor",
        tare_seconds=0.9 * REST / RATE,
        force_noise=2e-3 * (rod.force_scale if weak else 1.0),
        torque_noise=8e-4 * rod.moment_scale if weak else 4e-5,
        position_noise=1e-5,
    )


def judged(name: str, rod: vb.Rod, seed: int = 0) -> Judged:
    """Reconstruct and smooth the sweep with this rod, tared as such."""
    reactions = sensor(name).carrying(rod).reactions(logged(name, seed))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = vb.reconstruct(rod, reactions)
        smoothed = vb.smooth(found)
    point = np.concatenate([np.full((REST, 3), np.nan), loaded(name).point])
    return compared(
        found, smoothed, point, tuple(dict.fromkeys(str(one.message) for one in caught))
    )


def compared(
    found: vb.Reconstruction,
    smoothed: vb.Reconstruction,
    point: np.ndarray,
    said: tuple[str, ...] = (),
) -> Judged:
    """Against the true contact points (n, 3), NaN without contact."""
    rows = np.flatnonzero(np.isfinite(point[:, 0]))
    rows = rows[len(rows) // 20 : -(len(rows) // 20)]
    assert smoothed.covariance is not None
    off = smoothed.point[rows] - point[rows]
    known = np.isfinite(off).all(axis=1) & np.isfinite(smoothed.covariance[rows]).all(axis=(1, 2))
    inverse = np.linalg.pinv(smoothed.covariance[rows][known], hermitian=True)
    inside = np.zeros(len(rows), dtype=bool)
    inside[known] = np.einsum("ni,nij,nj->n", off[known], inverse, off[known]) < INSIDE
    errors = (np.linalg.norm(part.point[rows] - point[rows], axis=1) for part in (found, smoothed))
    return Judged(
        *(100 * float(np.nanmedian(error)) / float(found.rod.length) for error in errors),
        100 * float(inside.mean()),
        *(100 * float(np.mean(part.status[rows] == vb.Status.OK)) for part in (found, smoothed)),
        said,
        found,
        smoothed,
    )


def make() -> None:
    """Run the engine, and say how far its contacts are from those that its exact wrenches give."""
    sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
    import engine

    runs = {}
    for name, scene in SCENES.items():
        ball, way = engine.Body("sphere", (scene.radius - engine.SKIN,), scene.center), scene.trail
        for segments in (SEGMENTS // 2, SEGMENTS):
            run = engine.swept(
                engine.Wire(**scene.wire), [ball], way.position, way.orientation, segments=segments
            )
            assert run.rests.all() and not run.twice.any()
            found = vb.reconstruct(scene.rod, vb.Reactions(way, run.force, run.moment))
            error = np.linalg.norm(found.point - run.point, axis=1) / scene.rod.length
            touching = np.isfinite(error)
            off = f"{np.median(error[touching]):.1e} L (median), {error[touching].max():.1e} L"
            print(f"{name}, {segments} links: {touching.sum()} contacts, off by {off}")  # noqa: T201
        runs[name] = np.concatenate([run.force, run.moment, run.point], axis=1)
    np.savez_compressed(_FILE, **runs)


def main(seeds: int = 3) -> None:
    """Print the table: ranges over seeds of the noise, and the first warning."""
    for name, scene in SCENES.items():
        for label, rod in (("as it is", scene.rod), ("plain", scene.plain)):
            every = [judged(name, rod, seed) for seed in range(seeds)]
            numbers = " | ".join(
                f"{min(values):.2g} to {max(values):.2g}"
                for values in zip(*(one[:5] for one in every), strict=True)
            )
            said = every[0].said[0] if every[0].said else ""
            print(f"| {name} | {label} | {numbers} | {said} |", flush=True)  # noqa: T201


if __name__ == "__main__":
    make() if sys.argv[1:] == ["--make"] else main()
