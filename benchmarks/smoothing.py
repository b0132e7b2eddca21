"""Contacts of recorded and simulated sweeps: sample by sample, filtered before reconstruction, and
smoothed after it: `python benchmarks/smoothing.py [--simulated N]`.

Recordings are those in `../shared/recordings/sphere_60mm`; simulated ones are scans of the same
ball on random trails, measured by the same sensor with a tare and a drifting zero. Errors leave out
the first and last 5 % of each contact. For recordings without truth, distances from the ball stand
in for errors.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter
from scipy.stats import chi2

import vibrissa as vb
from vibrissa.inverse import CausalSmoother

FOLDER = Path(__file__).parents[1].parent / "shared" / "recordings" / "sphere_60mm"
CENTER, RADIUS = np.array([0.0, 0.0, 0.0575]), 0.03
RATE, SPEED, REST = 250.0, 0.01, 250
WINDOW, ORDER = 0.4, 2
DRIFT = 0.15
"""How far the simulated zero wanders in a second, in standard deviations of a sample."""


DRAWS = 400


class Sweep(NamedTuple):
    """One recording, with the truth if it is known."""

    name: str
    setup: vb.Setup
    reactions: vb.Reactions
    point: np.ndarray
    touching: np.ndarray
    span: tuple[float, float] | None
    """True start and end of the contact [s]."""


def recorded() -> list[Sweep]:
    """Recordings beside the checkout."""
    setup = vb.load_setup(FOLDER / "setup.toml")
    sweeps = []
    for path in sorted(FOLDER.glob("*/trail_y*.csv")):
        if path.name.endswith(".truth.csv"):
            continue
        reactions = vb.read_recording(path, setup)
        truth = path.parent / f"{path.stem}.truth.csv"
        name = f"{path.parent.name}/{path.stem}"
        assert reactions.time is not None
        if not truth.exists():
            nothing = np.zeros(len(reactions.time), dtype=bool)
            sweeps.append(
                Sweep(name, setup, reactions, np.full((len(nothing), 3), np.nan), nothing, None)
            )
            continue
        table = np.genfromtxt(truth, delimiter=",", names=True)
        touching = table["in_contact"] == 1
        rows = np.flatnonzero(touching)
        half = 0.5 / RATE
        span = float(reactions.time[rows[0]] - half), float(reactions.time[rows[-1]] + half)
        sweeps.append(
            Sweep(
                name,
                setup,
                reactions,
                np.stack([table[axis] for axis in "xyz"], axis=1),
                touching,
                span,
            )
        )
    return sweeps


def simulated(count: int, seed: int = 0) -> list[Sweep]:
    """Sweeps of the same rig on random trails, half of them with friction."""
    setup, rng = vb.load_setup(FOLDER / "setup.toml"), np.random.default_rng(seed)
    return [
        simulated_sweep(
            setup,
            rng,
            f"simulated {k}",
            rng.uniform(0.08, 0.4) * rng.choice([-1, 1]),
            0.2 * (k % 2),
        )
        for k in range(count)
    ]


def simulated_sweep(
    setup: vb.Setup, rng: np.random.Generator, name: str, offset: float, friction: float
) -> Sweep:
    """One sweep at `offset` rod lengths beside the ball's middle."""
    start = np.array([0.04, offset * setup.rod.length, 0.0])
    moving = start - np.arange(1, round(0.08 / SPEED * RATE))[:, None] * np.array(
        [SPEED / RATE, 0, 0]
    )
    path = vb.Trail(moving)
    scan = vb.scan(setup.rod, vb.surfaces.Sphere(CENTER, RADIUS), path, friction=friction)
    position = np.concatenate([np.tile(start, (REST, 1)), moving])
    time = np.arange(len(position)) / RATE
    still = np.zeros((REST, 3))
    force, moment = (
        np.concatenate([still, np.nan_to_num(part)])
        for part in (scan.reactions.force, scan.reactions.moment)
    )
    sensor = setup.sensor
    raw = sensor.measure(
        vb.Reactions(vb.Trail(position), force, moment, time=time),
        rng,
        force_tare=(0.4, -0.1, 1.9),
        torque_tare=(2e-3, -4e-3, 7e-4),
    )
    steps = rng.normal(0, DRIFT / np.sqrt(RATE), (2, len(time), 3))
    steps[:, :REST] = 0
    wander = np.cumsum(steps, axis=1)
    raw = type(raw)(
        raw.time,
        raw.position,
        raw.orientation,
        raw.force + sensor.force_noise * wander[0],
        raw.torque + sensor.torque_noise * wander[1],
    )
    rows = REST + np.flatnonzero(scan.in_contact)
    point = np.concatenate([np.full((REST, 3), np.nan), scan.point])
    touching = np.isfinite(point[:, 0])
    events = [
        event.parameter * (len(moving) - 1) + REST
        for event in scan.events
        if event.kind in (vb.EventKind.FIRST_CONTACT, vb.EventKind.DETACH)
    ]
    span = (
        (float(events[0] / RATE), float(events[-1] / RATE))
        if len(events) >= 2
        else (float(time[rows[0]]), float(time[rows[-1]]))
    )
    return Sweep(
        f"{name} y {offset:+.2f} mu {friction:g}",
        setup,
        sensor.reactions(raw),
        point,
        touching,
        span,
    )


def filtered(sweep: Sweep) -> vb.Reconstruction:
    """Savitzky-Golay on the wrench, then sample by sample."""
    reactions = sweep.reactions
    size = 2 * round(WINDOW * RATE / 2) + 1
    force, moment = (
        savgol_filter(part, size, ORDER, axis=0) for part in (reactions.force, reactions.moment)
    )
    return vb.reconstruct(
        sweep.setup.rod, vb.Reactions(reactions.trail, force, moment, time=reactions.time)
    )


def live(sweep: Sweep) -> np.ndarray:
    """Points of the causal smoother (n, 3)."""
    reactions = sweep.reactions
    assert reactions.covariance is not None
    smoother = CausalSmoother(
        sweep.setup.rod,
        reactions.covariance,
        position_covariance=reactions.position_covariance,
        speed=SPEED,
    )
    rows = zip(
        reactions.time,
        reactions.trail.position,
        reactions.trail.orientation,
        reactions.force,
        reactions.moment,
        strict=True,
    )
    return np.array([smoother.update(*row).point for row in rows])


def core_of(touching: np.ndarray) -> np.ndarray:
    """Rows of a contact without its first and last 5 %."""
    rows = np.flatnonzero(touching)
    cut = len(rows) // 20
    return rows[cut : len(rows) - cut]


def errors_of(sweep: Sweep, point: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Distances from the truth, or from the ball, in millimetres."""
    if sweep.span is None:
        return 1e3 * np.abs(np.linalg.norm(point[rows] - CENTER, axis=1) - RADIUS)
    return 1e3 * np.linalg.norm(point[rows] - sweep.point[rows], axis=1)


def coverage_of(sweep: Sweep, found: vb.Reconstruction, rows: np.ndarray) -> float:
    """Share of true points within the 95 % ellipsoids; without truth, of 95 % intervals along the
    ball's normal that contain its surface.
    """
    rows = rows[found.in_contact[rows]]
    covariance = found.covariance[rows]
    if sweep.span is None:
        away = found.point[rows] - CENTER
        normal = away / np.linalg.norm(away, axis=1, keepdims=True)
        deviation = np.sqrt(np.einsum("ni,nij,nj->n", normal, covariance, normal))
        return float(np.mean(np.abs(np.linalg.norm(away, axis=1) - RADIUS) < 1.96 * deviation))
    error = found.point[rows] - sweep.point[rows]
    return float(
        np.mean(
            np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) < chi2.isf(0.05, 3)
        )
    )


def standard_errors(sweep: Sweep, found: vb.Reconstruction, rows: np.ndarray) -> np.ndarray:
    """Errors along the axes of their ellipsoids, in standard deviations (n, 3)."""
    spread, axes = np.linalg.eigh(found.covariance[rows])
    return np.einsum("nji,nj->ni", axes, found.point[rows] - sweep.point[rows]) / np.sqrt(spread)


def expected_shares(errors: list[np.ndarray]) -> np.ndarray:
    """Shares inside the 95 % ellipsoids of perfectly calibrated trails: Gaussian errors of variance
    1, correlated along the trail like the given ones.
    """
    count = min(map(len, errors))
    power = np.mean(
        [np.abs(np.fft.rfft(np.clip(error, -4, 4), 2 * count, axis=0)) ** 2 for error in errors],
        axis=(0, 2),
    )
    correlation = np.fft.irfft(power)[:count] / count
    symmetric = np.concatenate([correlation, [0.0], correlation[:0:-1]]) / correlation[0]
    root = np.sqrt(np.maximum(np.fft.rfft(symmetric).real, 0))
    drawn = np.fft.irfft(
        np.fft.rfft(np.random.default_rng(0).normal(size=(DRAWS, 3, 2 * count))) * root
    )[..., :count]
    drawn /= drawn.std()
    return np.mean(np.sum(drawn**2, axis=1) < chi2.isf(0.05, 3), axis=1)


def report(sweep: Sweep) -> tuple[dict[str, float], np.ndarray]:
    """Print one sweep's rows; return its figures and its standardised errors."""
    found = vb.reconstruct(sweep.setup.rod, sweep.reactions)
    smooth = vb.smooth(found)
    assert smooth.smoothing is not None
    rows = core_of(smooth.in_contact if sweep.span is None else sweep.touching)
    figures = {}
    print(f"{sweep.name}{'  (distances from the ball)' if sweep.span is None else ''}")
    for name, point in (
        ("raw", found.point),
        ("filtered", filtered(sweep).point),
        ("causal", live(sweep)),
        ("smoothed", smooth.point),
    ):
        error = errors_of(sweep, point, rows)
        figures[f"{name} median"], figures[f"{name} p95"] = (
            float(np.nanmedian(error)),
            float(np.nanpercentile(error, 95)),
        )
        coverage = {"raw": found, "smoothed": smooth}.get(name)
        share = (
            ""
            if coverage is None
            else f"   in 95 % ellipsoids {100 * coverage_of(sweep, coverage, rows):5.1f} %"
        )
        if coverage is not None:
            figures[f"{name} coverage"] = coverage_of(sweep, coverage, rows)
        print(
            f"  {name:<10} median {figures[f'{name} median']:.3f} mm   95 % {figures[f'{name} p95']:.3f} mm{share}"
        )
    for touch in smooth.smoothing[0].touches:
        for name, true in zip(("start", "end"), sweep.span or (None, None), strict=True):
            value, deviation, limit = (
                getattr(touch, part) for part in (name, f"{name}_deviation", f"{name}_limit")
            )
            if value is not None:
                off = "" if true is None else f"   off by {1e3 * (value - true):+.1f} ms"
                print(
                    f"  {name:<10} {value:.4f} s ± {1e3 * deviation:.1f} ms   limit {1e3 * limit:.1f} ms{off}"
                )
                if true is not None:
                    figures[f"{name} error"], figures[f"{name} deviation"] = value - true, deviation
    return figures, standard_errors(sweep, smooth, rows[smooth.in_contact[rows]])


def main(count: int) -> list[dict[str, float]]:
    """Print the tables and their means; return the figures."""
    tables = []
    for title, sweeps in (
        ("recorded", recorded() if FOLDER.exists() else []),
        ("simulated", simulated(count) if count else []),
    ):
        if not sweeps:
            continue
        figures, errors = (list(part) for part in zip(*map(report, sweeps), strict=True))
        errors = [
            error for error, sweep in zip(errors, sweeps, strict=True) if sweep.span is not None
        ]
        with_truth = [
            row for row, sweep in zip(figures, sweeps, strict=True) if sweep.span is not None
        ]
        means = {
            name: float(np.mean([row[name] for row in with_truth]))
            for name in with_truth[0]
            if name.endswith(("median", "p95", "coverage"))
        }
        print(
            f"{title}, mean over the {len(with_truth)} trails with truth: "
            + ", ".join(f"{name} {value:.3f}" for name, value in means.items())
            + "\n",
            flush=True,
        )
        inside = [row["smoothed coverage"] for row in with_truth]
        expected = expected_shares(errors)
        print(
            f"inside, smoothed, trail by trail: standard deviation {np.std(inside, ddof=1):.3f}; "
            f"of perfectly calibrated errors as correlated as these {expected.std():.3f}, nine of ten trails within "
            f"{np.quantile(expected, 0.05):.3f} to {np.quantile(expected, 0.95):.3f}\n",
            flush=True,
        )
        tables += figures
    return tables


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--simulated", type=int, default=6)
    main(parser.parse_args().simulated)
