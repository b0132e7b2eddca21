"""How many random positions remain unsolved: `python benchmarks/random_positions.py [SEED]
[OBJECTS]`, by default 7 objects of each kind, 1.1e5 positions in all.

Objects of random size and orientation, about 0.3 to 1.1 rod lengths above the clamp; twenty straight
trails of 101 positions in all directions under each, with the clamp tilted by about 0.15 rad.
Objects with edges are touched by a rod of radius 0.01 L. A position is unsolved if its status is
NOT_CONVERGED or NO_EQUILIBRIUM.
"""

import sys
from collections import Counter
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa import surfaces

Draw = np.random.Generator
TRAILS, COUNT = 20, 101
ROD = vb.Rod(1.0, 1.0, radius=0.01)
ORIGIN, UP = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
SMOOTH: dict[str, Callable[[Draw], vb.surfaces.Surface]] = {
    "ellipsoid": lambda rng: surfaces.Ellipsoid(ORIGIN, rng.uniform(0.2, 0.6, 3)),
    "sphere": lambda rng: surfaces.Sphere(ORIGIN, float(rng.uniform(0.2, 0.6))),
    "paraboloid": lambda rng: surfaces.EllipticParaboloid(
        float(rng.uniform(0, 1)), float(rng.uniform(0, 1.5)), 0.0
    ),
    "superquadric": lambda rng: surfaces.Superquadric(
        ORIGIN, rng.uniform(0.2, 0.6, 3), rng.uniform(0.5, 1.5, 2)
    ),
}
EDGED: dict[str, Callable[[Draw], vb.surfaces.Surface]] = {
    "capsule": lambda rng: surfaces.Capsule(
        ORIGIN, UP, float(rng.uniform(0.1, 0.3)), float(rng.uniform(0.2, 0.6))
    ),
    "box": lambda rng: surfaces.Box(ORIGIN, rng.uniform(0.14, 0.42, 3)),
    "cylinder": lambda rng: surfaces.Cylinder(
        ORIGIN, UP, float(rng.uniform(0.2, 0.6)), float(rng.uniform(0.2, 0.6))
    ),
    "cone": lambda rng: surfaces.Cone(
        ORIGIN, UP, float(rng.uniform(0.2, 0.6)), float(rng.uniform(0.2, 0.6))
    ),
}


def placed(surface: vb.surfaces.Surface, rng: Draw, *, bowl: bool) -> vb.surfaces.Surface:
    """Place the object somewhere above the clamp; a bowl stays roughly upright."""
    turn = (
        Rotation.from_rotvec(rng.normal(0, 0.2, 3))
        if bowl
        else Rotation.from_quat(rng.normal(size=4))
    )
    low, high = (0.3, 0.8) if bowl else (0.5, 1.1)
    return surface.placed(turn, (*rng.uniform(-0.2, 0.2, 2), rng.uniform(low, high)))


def trails(rng: Draw) -> vb.Trail:
    """Straight trails through the neighbourhood."""
    azimuth, aside = rng.uniform(0, 2 * np.pi, TRAILS), rng.uniform(-0.5, 0.5, TRAILS)
    along = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    across = np.stack([-along[:, 1], along[:, 0], 0 * azimuth], axis=1)
    position = (
        np.linspace(-1.5, 1.5, COUNT)[None, :, None] * along[:, None]
        + (aside[:, None] * across)[:, None]
    )
    tilt = Rotation.from_rotvec(rng.normal(0, 0.15, (TRAILS, 3))).as_quat()
    return vb.Trail(position, np.repeat(tilt[:, None], COUNT, axis=1))


def main() -> None:
    """Count by kind, and in total."""
    seed, objects = (int(word) for word in (sys.argv[1:] + ["11", "7"][len(sys.argv) - 1 :])[:2])
    rng, unsolved, positions = np.random.default_rng(seed), 0, 0
    for kind, build in {**SMOOTH, **EDGED}.items():
        statuses: Counter[str] = Counter()
        contacts = 0
        for _ in range(objects):
            surface = placed(build(rng), rng, bowl=kind == "paraboloid")
            scan = vb.scan(ROD, surface, trails(rng), finite_radius=kind in EDGED)
            statuses.update(vb.Status(int(status)).name for status in scan.status.ravel())
            contacts += int(scan.in_contact.sum())
        failed = statuses["NOT_CONVERGED"] + statuses["NO_EQUILIBRIUM"]
        unsolved, positions = unsolved + failed, positions + statuses.total()
        print(
            f"{kind:13s} {statuses.total():6d} positions, {contacts:6d} in contact, {failed} unsolved; {dict(statuses)}",
            flush=True,
        )
    print(
        f"{'all':13s} {positions:6d} positions, {unsolved} unsolved: {1e4 * unsolved / positions:.2f} in 10,000"
    )


if __name__ == "__main__":
    main()
