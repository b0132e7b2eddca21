"""Where six reactions leave more than one contact: share of the contacts of random sweeps, against
the curvature of the rod. Writes `docs/images/uniqueness.png`; takes two minutes.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import vibrissa as vb

IMAGES = Path(__file__).parent / "images"
CURVATURES = np.array([0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
"""Times the length."""
SWEEPS, POSITIONS = 24, 61


def swept(curvature: float, random: np.random.Generator) -> tuple[vb.Rod, vb.Scan]:
    """A rod bent to an arc, swept over a ball from all sides."""
    rod = vb.Rod(length=1.0, bending_stiffness=1.0).curved(vb.RestShape.arc(1 / curvature))
    angle = curvature * np.linspace(0, 1, 9)
    along = np.stack([1 - np.cos(angle), 0 * angle, np.sin(angle)], axis=1) / curvature
    trails = []
    for _ in range(SWEEPS):
        aim = along[random.integers(4, 9)] + random.normal(size=3) * 0.05
        way = random.normal(size=3)
        way[2] *= 0.3
        way /= np.linalg.norm(way)
        start, stop = BALL - aim - way, BALL - aim + 0.5 * way
        trails.append(vb.Trail.line(start=start, stop=stop, count=POSITIONS))
    return rod, vb.scan(rod, vb.surfaces.Sphere(center=BALL, radius=0.2), vb.Trail.stack(trails))


BALL = np.array([0.0, 0.0, 1.0])


def shares() -> dict[str, list[float]]:
    """Shares of the contacts that are not unique [%]: with any friction up to 0.75, and without."""
    found: dict[str, list[float]] = {"unknown friction": [], "no friction": []}
    for curvature in CURVATURES:
        rod, scan = swept(float(curvature), np.random.default_rng(3))
        sound = scan.in_contact & (scan.status == vb.Status.OK)
        for name, friction in (("unknown friction", None), ("no friction", 0.0)):
            seen = vb.reconstruct(rod, scan.reactions, friction=friction)
            several = sound & (seen.status == vb.Status.NOT_UNIQUE)
            wrong = sound & (seen.status == vb.Status.OK)
            wrong &= np.linalg.norm(seen.point - scan.point, axis=-1) > 1e-6
            found[name].append(100 * several.sum() / sound.sum())
            print(curvature, name, sound.sum(), several.sum(), "wrong", wrong.sum())  # noqa: T201
    return found


def main() -> None:
    """Draw the figure."""
    figure, axes = plt.subplots(figsize=(5.2, 3.2), layout="constrained")
    for (name, values), marker in zip(shares().items(), "os", strict=True):
        axes.plot(CURVATURES, values, marker=marker, label=name)
    axes.set_xlabel("rest curvature times length, κL [rad]")
    axes.set_ylabel("contacts that are not unique [%]")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(IMAGES / "uniqueness.png", dpi=200)


if __name__ == "__main__":
    main()
