"""Tapered, curved, heavy and softly held rods: the first call, microseconds an equilibrium and an
inverse sample in batches, how the former grows with the accuracy asked for, and the same rod brought to
rest by MuJoCo, as a chain of rigid links, and by PyElastica, as a Cosserat rod.

    python benchmarks/real_rods.py [NAME ...]

One core. `first` is in a process of its own without a cache of compiled code, imports included. A
batch is a hundred trails under a ball, whose positions are nearly all in contact, events and checks
included. With MuJoCo and PyElastica (group `benchmark`) the rod named "both" is stepped to rest too: on
all poses of one trail, and on three of them (two minutes).
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
SOME = (60, 120, 180)
"""Poses for PyElastica: early, in the middle and late in the contact."""


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


def elastica() -> str:
    """PyElastica's rod of 10, 20 and 40 elements at three poses, and how much the last is changed by a
    hundredth of the stiffness against shear and stretch.
    """
    from elastica_rods import relaxed  # noqa: PLC0415

    rod, way, rows = RODS["both"], trail(0.1 * LENGTH), list(SOME)
    scan = vb.scan(rod, BALL, way)
    clamps = way.position[rows]
    # Seen from the clamp, the ball moves.
    centers, start = BALL.center - clamps, BALL.center - way.position[0]

    def run(elements: int, softness: float = 1.0) -> tuple[str, float]:
        begin = perf_counter()
        found = relaxed(rod, centers, BALL.radius, start, elements, softness)
        each = (perf_counter() - begin) / len(rows)
        fine = np.linspace(0, LENGTH, 2001)
        along = LENGTH * (np.arange(elements) + 0.5) / (elements - 0.5)
        shape = 0.0
        for row, clamp, nodes in zip(rows, clamps, found.nodes, strict=True):
            line = scan.elastic_line(row, count=len(fine)) - clamp
            there = np.array([np.interp(along, fine, part) for part in line.T]).T
            shape = max(shape, np.linalg.norm(nodes - there, axis=1).max() / LENGTH)
        off = np.linalg.norm(found.point + clamps - scan.point[rows], axis=1).max() / LENGTH
        size = np.linalg.norm(scan.contact_force[rows], axis=1) / rod.force_scale
        force = np.abs(np.linalg.norm(found.force, axis=1) / size - 1).max()
        rests = "" if found.rests.all() else ", NOT AT REST"
        words = f"{each:.1f} s a contact, contacts off by {off:.1e} L, shapes by {shape:.1e} L, forces by {force:.1%}{rests}"
        return f"{elements} elements: {words}", each

    run(4)  # compiles
    texts, times = zip(*(run(elements) for elements in (10, 20, 40)), strict=True)
    soft, _ = run(40, softness=100.0)
    alone = best_of(5, lambda: vb.scan(rod, BALL, way), scan.in_contact.sum())
    return (
        "PyElastica (largest of three poses): "
        + "; ".join(texts)
        + f"; a hundred times softer against shear and stretch, {soft}; one trail of vb.scan: "
        f"{alone:.0f} µs, ratio {times[-1] / alone * 1e6:.0f}"
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
    for name, compared in (("MuJoCo", engine), ("PyElastica", elastica)):
        try:
            print(f"\n{compared()}", flush=True)
        except ImportError:
            print(f"\n{name} is not installed (group `benchmark`): no comparison")


if __name__ == "__main__":
    main()
