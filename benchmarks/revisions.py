"""Compare two revisions: `python benchmarks/revisions.py OLD NEW [--repeats N]`.

Each is installed into an environment of its own, with the newest releases that its version ranges
allow. Then both do the same work in turn, in fresh processes; the table gives seconds and ratios.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]

COMMON = """
import sys, time
import numpy as np
started = time.perf_counter()
import vibrissa as vb
S, unit = vb.surfaces, vb.Rod.unit()
thick = vb.Rod(length=1.0, bending_stiffness=1.0, radius=0.01)
ball = S.Sphere(center=(0, 0, 1.15), radius=0.6)
box = S.Box(center=(0, 0, 1.0), half_extents=(0.4, 0.4, 0.4))
cross = S.Union([ball, S.Box(center=(0.7, 0, 1.0), half_extents=(0.3, 0.4, 0.4))])
bowl = S.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
def corner():
    # Twenty triangles, with a concave edge along y, above the clamp.
    outline = [(-0.8, 0.5), (0.0, 0.5), (0.0, 0.9), (0.8, 0.9), (0.8, 1.4), (-0.8, 1.4)]
    corners = [(x, y, z) for y in (-0.5, 0.5) for x, z in outline]
    cap = [(0, 1, 2), (0, 2, 5), (2, 4, 5), (2, 3, 4)]
    sides = [(i, (i + 1) % 6) for i in range(6)]
    faces = cap + [(c + 6, b + 6, a + 6) for a, b, c in cap]
    faces += [f for i, j in sides for f in ((i, i + 6, j), (j, i + 6, j + 6))]
    return S.Mesh(np.array(corners), np.array(faces))
one = vb.Trail.line(start=(1.2, 0.2, 0), stop=(-1.2, 0.2, 0), count=201)
def batch(m):
    x, y = np.linspace(1.2, -1.2, 241), np.linspace(0.05, 0.6, m)
    place = np.zeros((m, 241, 3))
    place[..., 0], place[..., 1] = x, y[:, None]
    return vb.Trail(place, np.broadcast_to((0.0, 0, 0, 1), (m, 241, 4)))
def best(count, work):
    work()
    times = []
    for _ in range(count):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)
def first(work):
    vb.surfaces, vb.Trail
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
def noisy(m=1, n=4000):
    scan = vb.scan(unit, ball, vb.Trail.line(start=(1.0, 0.2, 0), stop=(-1.0, 0.2, 0), count=n))
    rng, sigma = np.random.default_rng(0), 2e-3
    force, moment = (part + sigma * rng.normal(size=part.shape) for part in (scan.reactions.force, scan.reactions.moment))
    return vb.Reactions(scan.reactions.trail, force, moment, time=np.arange(n) / 1e3, covariance=sigma**2 * np.eye(6))
def swept_wire():
    wire = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
    skull = S.Sphere(center=(0, 0, 0.0575), radius=0.03)
    sensor = vb.Sensor(np.array([0.003, -0.002, 0.02]), np.array([0.05, 0.1, -0.2, 0.97]), "on_sensor",
        tare_seconds=0.9, force_noise=2e-3, torque_noise=4e-5, position_noise=1e-5)
    sweeps, rng = [], np.random.default_rng(2)
    for y in (0.005, -0.01):
        way = np.linspace((0.04, y, 0.0), (-0.0475, y, 0.0), 1620)
        scan = vb.scan(wire, skull, vb.Trail(np.vstack([np.repeat(way[:1], 250, axis=0), way])))
        time = np.arange(1870) / 250.0
        exact = vb.Reactions(scan.trail, scan.reactions.force, scan.reactions.moment, time=time)
        sweeps.append(sensor.measure(exact, rng, force_tare=(0.3, -0.1, 1.9)))
    soft = vb.Rod.cylinder(length=0.0515, radius=0.25e-3, youngs_modulus=170e9)
    return sweeps, vb.Setup(soft, sensor, skull)
"""

WORK = {
    "import vibrissa and its functions": "vb.scan, vb.reconstruct; print(time.perf_counter() - started)",
    "first scan: ball": "print(first(lambda: vb.scan(unit, ball, one)))",
    "first scan: ball, friction 0.3": "print(first(lambda: vb.scan(unit, ball, one, friction=0.3)))",
    "first scan: bowl": "print(first(lambda: vb.scan(unit, bowl, one)))",
    "first scan: box, finite radius": "print(first(lambda: vb.scan(thick, box, one, finite_radius=True)))",
    "first scan: mesh with a concave edge": "o = corner(); print(first(lambda: vb.scan(unit, o, one)))",
    "first scan: union": "print(first(lambda: vb.scan(unit, cross, one)))",
    "one trail of 201 positions": "print(best(10, lambda: vb.scan(unit, bowl, one)))",
    "1000 trails of 241 positions": "t = batch(1000); print(best(2, lambda: vb.scan(unit, bowl, t)))",
    "reconstruct 241,000 exact samples": "r = vb.scan(unit, bowl, batch(1000)).reactions; print(best(5, lambda: vb.reconstruct(unit, r)))",
    "reconstruct 4000 noisy samples": "r = noisy(); print(best(3, lambda: vb.reconstruct(unit, r)))",
    "smooth 4000 noisy samples": "f = vb.reconstruct(unit, noisy()); print(best(1, lambda: vb.smooth(f)))",
    "calibrate two sweeps of 1870 samples": "s, start = swept_wire(); print(best(1, lambda: vb.calibrate(s, start)))",
}
SECOND = {
    "second process, ball: from python to the result": "vb.scan(unit, ball, one); print(time.perf_counter() - started)",
}


def installed(revision: str, folder: Path) -> Path:
    """The Python of a fresh environment with a revision installed."""
    source, home = folder / "source", folder / "environment"
    source.mkdir(parents=True)
    archive = subprocess.run(
        ["git", "archive", revision], cwd=ROOT, check=True, capture_output=True
    ).stdout
    subprocess.run(["tar", "x", "-C", str(source)], input=archive, check=True)
    subprocess.run(["uv", "venv", "-q", str(home)], check=True)
    python = home / "bin" / "python"
    wanted = f"{source}[calibrate,mesh]"
    install = ["uv", "pip", "install", "-q", "--compile-bytecode", "--python", str(python), wanted]
    subprocess.run(install, check=True)
    return python


def seconds(python: Path, work: str, cores: int, cache: str) -> float:
    """Seconds that a process prints; NaN if it fails."""
    usable = sorted(os.sched_getaffinity(0))[:cores]
    done = subprocess.run(
        [str(python), "-W", "ignore", "-c", COMMON + work],
        env=os.environ | {"VIBRISSA_CACHE": cache},
        preexec_fn=lambda: os.sched_setaffinity(0, usable),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        print(done.stderr[-300:], file=sys.stderr)
        return float("nan")
    return float(done.stdout.split()[-1])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("revisions", nargs=2)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        pythons = [
            installed(revision, Path(folder) / str(index))
            for index, revision in enumerate(options.revisions)
        ]
        print(f"| work, s | {' | '.join(options.revisions)} | ratio |\n|---|---|---|---|")

        def row(name: str, work: str, cores: int, cache: list[str]) -> None:
            told: list[list[float]] = [[], []]
            for _ in range(options.repeats):
                for times, python, kept in zip(told, pythons, cache, strict=True):
                    times.append(seconds(python, work, cores, kept))
            old, new = (statistics.median(times) for times in told)
            print(f"| {name} | {old:.3g} | {new:.3g} | {old / new:.2f} |", flush=True)

        for name, work in WORK.items():
            row(name, work, 1, ["off", "off"])
        batch = "1000 trails of 241 positions"
        row(f"{batch}, two cores", WORK[batch], 2, ["off", "off"])
        kept = [str(Path(folder) / f"cache{index}") for index in range(2)]
        for work in SECOND.values():
            for python, cache in zip(pythons, kept, strict=True):
                seconds(python, work, 1, cache)
        for name, work in SECOND.items():
            row(name, work, 1, kept)


if __name__ == "__main__":
    main()
