"""Do error bars hold where all that has a tolerance is off at random? `python benchmarks/effects_drawn.py [--repeats 10] [--scenes NAME ...] [--made FOLDER]`.

Runs of the independent engine (`bench_recordings.py`) are logged again and again with parameters drawn from the usual tolerances, which the setup states; the
mean share of true points and normals inside the 95 % ellipsoids has to be between 92 and 98 %, raw and smoothed. Errors are shared by a whole sweep, so that
single sweeps scatter widely.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import chi2

import vibrissa as vb
from bench_recordings import Recording, made
from effects import CACHE, USUAL
from logs import Faults, Log

SCENES = ("ball5", "oblique", "ellipsoid")


def drawn(rng: np.random.Generator) -> Faults:
    """Faults drawn from the usual tolerances; those of EI and length as stated over true."""
    return Faults(
        modulus=1 + 0.04 * rng.normal(),
        radius=1 + 0.01 * rng.normal(),
        length=1 + 0.4e-3 / 50e-3 * rng.normal(),
        shifted=tuple(0.4e-3 * rng.normal(size=3)),
        turned=tuple(0.01 * rng.normal(size=3)),
        gain=tuple(1 + 0.015 * rng.normal(size=6)),
        delay=5e-3 * rng.normal(),
    )


def contacts_of(log: Log, tolerances: str, folder: Path) -> tuple[vb.Reconstruction, vb.Reconstruction]:
    """Raw and smoothed."""
    log.write(folder, "sweep")
    (folder / "sweep.toml").write_text(log.setup + f"\n[tolerances]\n{tolerances}")
    setup = vb.load_setup(folder / "sweep.toml")
    found = vb.reconstruct(setup.rod, vb.read_recording(folder / "sweep.csv", setup))
    return found, vb.smooth(found)


def inside(found: np.ndarray, true: np.ndarray, covariance: np.ndarray, dimensions: int) -> float:
    """Share of true values (n, 3) within the 95 % ellipsoids."""
    error = found - true
    inverse = np.linalg.pinv(covariance, rcond=1e-9 if dimensions == 3 else 1e-6, hermitian=True)
    return float(np.mean(np.einsum("ni,nij,nj->n", error, inverse, error) < chi2.isf(0.05, dimensions)))


def shares(found: vb.Reconstruction, log: Log) -> dict[str, float]:
    """What is inside, of points and normals; errors and deviations [mm], medians; rows that are OK."""
    rows = np.isfinite(log.point[:, 0]) & found.in_contact & np.isfinite(found.point[:, 0])
    ok = rows & (found.status == vb.Status.OK)
    assert found.covariance is not None and found.normal_covariance is not None
    return {
        "points": 100 * inside(found.point[rows], log.point[rows], found.covariance[rows], 3),
        "points OK": 100 * inside(found.point[ok], log.point[ok], found.covariance[ok], 3) if ok.any() else np.nan,
        "normals": 100 * inside(found.normal[rows], log.direction[rows], found.normal_covariance[rows], 2),
        "OK": 100 * ok.sum() / rows.sum(),
        "error, mm": 1e3 * float(np.median(np.linalg.norm(found.point - log.point, axis=1)[rows])),
        "stated, mm": 1e3 * float(np.median(np.sqrt(np.linalg.eigvalsh(found.covariance[rows])[:, -1]))),
    }


def repeats(scene: str, count: int, made_in: Path, seed: int) -> Iterator[tuple[int, str, dict[str, float]]]:
    """Figures of each repeat, raw and smoothed."""
    with TemporaryDirectory() as folder:
        for k in range(seed, seed + count):
            faults = drawn(np.random.default_rng((k, len(scene))))
            log = made(replace(Recording(scene), faults=faults), made_in / "runs", k)
            raw, smooth = contacts_of(log, USUAL, Path(folder))
            yield k, "raw", shares(raw, log)
            yield k, "smoothed", shares(smooth, log)


def main(scenes: list[str], count: int, made_in: Path, seed: int) -> None:
    """Print means over the repeats."""
    for scene in scenes:
        table: dict[str, list[dict[str, float]]] = {"raw": [], "smoothed": []}
        for k, kind, figures in repeats(scene, count, made_in, seed):
            table[kind].append(figures)
            print(f"  {scene} {k} {kind}: " + ", ".join(f"{name} {value:.3g}" for name, value in figures.items()), flush=True)
        for kind, rows in table.items():
            means = {name: (np.nanmean([row[name] for row in rows]), np.nanmin([row[name] for row in rows])) for name in rows[0]}
            print(f"{scene}, {kind}, {count} repeats, mean (lowest): " + ", ".join(f"{n} {m:.3g} ({w:.3g})" for n, (m, w) in means.items()))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--made", type=Path, default=CACHE)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    main(given.scenes, given.repeats, given.made, given.seed)
