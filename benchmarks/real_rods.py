"""Tapered, curved, heavy and softly held rods: the first call, microseconds an equilibrium and an
inverse sample in batches, how the former grows with the accuracy asked for, and a chain of rigid links
stepped to rest by MuJoCo on the same poses.

    python benchmarks/real_rods.py [NAME ...]

One core. `first` is in a process of its own without a cache of compiled code, imports included. A
batch is a hundred trails under a ball, whose positions are nearly all in contact, events and checks
included. With MuJoCo (group `benchmark`) the row named "both" is stepped to rest too.
"""

import os
import subprocess
import sys
from pathlib import Path

from timing import best_of, pin_to_one_core

pin_to_one_core()
os.environ["VIBRISSA_THREADS"] = "1"

from time import perf_counter  # noqa: E402

import numpy as np  # noqa: E402

import vibrissa as vb  # noqa: E402

LENGTH, STEEL = 0.05, 206e9
BALL = vb.surfaces.Sphere(center=(0, 0, 1.15 * LENGTH), radius=0.6 * LENGTH)
WIRE = vb.Rod.cylinder(length=LENGTH, radius=0.1e-3, youngs_modulus=STEEL, density=7850)
TAPER = vb.Rod.tapered(length=LENGTH, base_radius=0.25e-3, tip_radius=0.1e-3, youngs_modulus=STEEL)
ARC = vb.RestShape.arc(2 * LENGTH, roll=0.7)
RODS = {
    "plain": WIRE,
    "tapered": TAPER,
    "curved": WIRE.curved(ARC),
    "both": TAPER.curved(ARC),
    "whisker": vb.Rod.tapered(
        length=LENGTH, base_radius=0.1e-3, tip_radius=5e-6, youngs_modulus=3e9
    ).curved(vb.RestShape.parabola(5.0, roll=0.5)),
    "heavy": WIRE.loaded(vb.Loads(gravity=(0, 0, -9.81))),
    "soft": WIRE.on(vb.Support.pivot(stiffness=(0.1, 0.15, 0.5))),
}
TRAILS, COUNT = 100, 201
ACCURACIES = (1e-6, 1e-8, 1e-10, 1e-12)
FIRST = "first call"


def trail(y: float) -> vb.Trail:
    """A sweep along −x, 0.006 L a step."""
    x = 0.6 * LENGTH
    return vb.Trail.line(start=(x, y, 0), stop=(-x, y, 0), count=COUNT)


def touching(scan: vb.Scan) -> vb.Reactions:
    """Reactions of all rows in contact that are sound."""
    rows = scan.in_contact & (scan.status == vb.Status.OK)
    at, given = scan.trail, scan.reactions
    return vb.Reactions(
        vb.Trail(at.position[rows], at.orientation[rows]), given.force[rows], given.moment[rows]
    )


def first_call(name: str) -> float:
    """Seconds from starting Python to the first scan, without any compiled code."""
    begin = perf_counter()
    subprocess.run(
        [sys.executable, __file__, FIRST, name],
        check=True,
        env=os.environ | {"VIBRISSA_CACHE": "off"},
        cwd=Path(__file__).parent,
    )
    return perf_counter() - begin


def row(name: str, accuracy: float) -> str:
    """Times of a batch, largest residual of its sound rows, and error of the contacts found."""
    rod = RODS[name]
    trails = vb.Trail.stack([trail(y) for y in np.linspace(-0.2, 0.2, TRAILS) * LENGTH])
    scan = vb.scan(rod, BALL, trails, accuracy=accuracy)
    contacts = scan.in_contact
    forward = best_of(3, lambda: vb.scan(rod, BALL, trails, accuracy=accuracy), contacts.sum())
    samples = touching(scan)
    vb.reconstruct(rod, samples, accuracy=accuracy)
    inverse = best_of(
        5, lambda: vb.reconstruct(rod, samples, accuracy=accuracy), len(samples.force)
    )
    largest = np.nanmax(scan.residual[contacts & (scan.status == vb.Status.OK)])
    return (
        f"| {name} | {accuracy:g} | {contacts.mean():.0%} | {len(scan.events)} | "
        f"{forward:.1f} | {inverse:.2f} | {largest:.0e} | {np.mean(scan.status[contacts] == 0):.1%} |"
    )


def engine() -> str:
    """MuJoCo's chain of 36 links, tapered and bent at rest, on one trail."""
    import engine  # noqa: PLC0415

    wire = engine.Wire(
        length=LENGTH,
        radius=0.25e-3,
        youngs_modulus=STEEL,
        tip=0.4,
        sagitta=tuple(LENGTH / 16 * np.array([np.cos(0.7), np.sin(0.7)])),
    )
    ball = [engine.Body("sphere", (0.6 * LENGTH - engine.SKIN,), (0.0, 0.0, 1.15 * LENGTH))]
    way = trail(0.1 * LENGTH)
    begin = perf_counter()
    run = engine.swept(wire, ball, way.position, way.orientation)
    touches = np.isfinite(run.point[:, 0])
    each = (perf_counter() - begin) / touches.sum() * 1e6
    scan = vb.scan(RODS["both"], BALL, way)
    alone = best_of(5, lambda: vb.scan(RODS["both"], BALL, way), scan.in_contact.sum())
    rows = touches & scan.in_contact & ~run.twice
    off = np.median(np.linalg.norm(run.point[rows] - scan.point[rows], axis=1)) / LENGTH
    return (
        f"MuJoCo, 36 links: {each:,.0f} µs a contact, contacts off by {off:.1e} L (median); "
        f"one trail of vb.scan: {alone:.0f} µs, ratio {each / alone:.0f}"
    )


def main() -> None:
    """Print the table."""
    if sys.argv[1:2] == [FIRST]:
        vb.scan(RODS[sys.argv[2]], BALL, trail(0.1 * LENGTH))
        return
    chosen = [name for name in RODS if not sys.argv[1:] or name in sys.argv[1:]]
    print("| rod | first call, s |\n|---|---|")
    for name in chosen:
        print(f"| {name} | {first_call(name):.1f} |", flush=True)
    print(
        "\n| rod | accuracy | in contact | events | µs an equilibrium | µs an inverse sample | "
        "largest residual | sound |\n|---|---|---|---|---|---|---|---|"
    )
    for name in chosen:
        for accuracy in ACCURACIES if name == "both" else (1e-8, 1e-10):
            print(row(name, accuracy), flush=True)
    try:
        print(f"\n{engine()}")
    except ImportError:
        print("\nMuJoCo is not installed (group `benchmark`): no comparison")


if __name__ == "__main__":
    main()
