"""Measure what docs/accuracy.md says, and draw its figures: `python docs/make_accuracy.py [NAME
...]` (oracle, engine, recordings, coverage).

The numbers go to docs/accuracy.json, from which the page takes them. Oracle and recordings lie in
the folder `shared` beside the checkout, as for the tests; `engine` needs the dependency group
`benchmark`.
"""

import json
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from scipy.stats import chi2

mpl.use("Agg")

import vibrissa as vb
from vibrissa.plot import journal, save_as
from vibrissa.plot.style import COLUMN, PAGE

HERE = Path(__file__).parent
IMAGES, NUMBERS = HERE / "images" / "accuracy", HERE / "accuracy.json"
SHARED = HERE.parents[1] / "shared"
RAW, SMOOTH = "#c77700", "#1d5fa8"
MARKERS = "osD^v"
STYLES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))

Numbers = dict[str, Any]


def oracle() -> Numbers:
    """Every field of 790 contacts of the paper's case against solutions with 40 digits."""
    rows = pd.read_csv(SHARED / "oracle" / "paraboloid_trails.csv")
    grid = np.round(np.arange(1.2, -1.4001, -0.025), 3)
    offsets = np.unique(rows.y0)
    trail = vb.Trail.stack([vb.Trail([(x, y, 0.0) for x in grid]) for y in offsets])
    scan = vb.scan(vb.Rod.unit(), vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4), trail)
    at = np.searchsorted(offsets, rows.y0), np.searchsorted(-grid, -rows.x0)
    found = {
        "contact point": (scan.point, ["xi", "eta", "theta"]),
        "normal": (scan.normal, ["n_x", "n_y", "n_z"]),
        "arc length": (scan.arc_length[..., None], ["s1"]),
        "force": (scan.reactions.force, ["f0x", "f0y", "f0z"]),
        "moment": (scan.reactions.moment, ["m0x", "m0y", "m0z"]),
    }
    errors = {
        name: np.abs(values[at] - rows[columns].to_numpy()).max(axis=1)
        for name, (values, columns) in found.items()
    }
    _, axes = plt.subplots(figsize=(COLUMN, 2.6), layout="constrained")
    share = np.arange(1, len(rows) + 1) / len(rows)
    for style, (name, error) in zip(STYLES, errors.items(), strict=True):
        # What agrees to the last digit has no logarithm.
        axes.semilogx(np.sort(np.maximum(error, 1e-18)), share, linestyle=style, label=name)
    axes.axvline(np.finfo(float).eps, color="0.4", linewidth=0.7, linestyle="--")
    axes.annotate(
        "spacing of\n64-bit numbers at 1",
        (np.finfo(float).eps, 0.04),
        xytext=(4, 0),
        textcoords="offset points",
        fontsize=7,
        color="0.3",
    )
    axes.set(
        xlabel="difference from 40 digits",
        ylabel="share of contacts",
        xlim=(1e-17, 1e-13),
        ylim=(0, 1.02),
    )
    axes.legend(loc="center right", fontsize=7)
    save_as(axes, IMAGES / "oracle.png")
    worst = max(errors.values(), key=np.max).max()
    return {"oracle_contacts": len(rows), "oracle_worst": _power(worst)}


def engine() -> Numbers:
    """Differences from a chain of capsules in MuJoCo, by the length of its segments."""
    sys.path.insert(0, str(HERE.parent / "benchmarks"))
    import mujoco  # noqa: PLC0415

    from chains import (  # noqa: PLC0415
        CENTER,
        RADIUS,
        REST,
        ROD,
        TRAIL,
        ball_geom,
        chain,
        compared,
        hinges,
        settled,
    )

    sphere = vb.surfaces.Sphere(center=CENTER, radius=RADIUS)
    scan = vb.scan(ROD, sphere, TRAIL, finite_radius=True)
    counts = np.array([5, 10, 20, 40])
    medians = []
    for count in counts.tolist():
        model = mujoco.MjModel.from_xml_string(chain(count, hinges, ball_geom()))
        rows = compared(scan, settled(model, TRAIL.position / ROD.length, REST / count))
        medians.append({name: float(np.median(values)) for name, values in rows.items()})
    table = {name: np.array([row[name] for row in medians]) for name in medians[0]}
    table["point"] = table["point"] / (1e3 * ROD.length)
    names = {"force": "force", "moment": "moment", "point": "contact point / L"}
    _, axes = plt.subplots(figsize=(COLUMN, 2.6), layout="constrained")
    for marker, (name, values) in zip(MARKERS, table.items(), strict=False):
        axes.loglog(counts, values, marker + "-", markersize=4, label=names[name])
    guide = table["force"][0] * 1.8 * (counts[0] / counts) ** 2
    axes.loglog(counts, guide, color="0.5", linewidth=0.7, linestyle="--", label="second order")
    axes.set(xlabel="segments of the chain", ylabel="median relative difference")
    axes.set_xticks(counts, [str(count) for count in counts])
    axes.minorticks_off()
    axes.legend()
    save_as(axes, IMAGES / "engine.png")
    order = np.log(table["force"][0] / table["force"][-1]) / np.log(counts[-1] / counts[0])
    return {
        "engine_version": mujoco.__version__,
        "engine_segments": int(counts[-1]),
        "engine_force": _power(table["force"][-1]),
        "engine_moment": _power(table["moment"][-1]),
        "engine_point_um": f"{1e6 * ROD.length * table['point'][-1]:.1f}",
        "engine_order": f"{order:.1f}",
    }


def recordings() -> Numbers:
    """Contact points from logs of an independent engine, against its own contacts."""
    folder = SHARED / "recordings" / "sphere_60mm"
    setup = vb.load_setup(folder / "setup.toml")
    names = {
        "frictionless/trail_y+0.10": "no friction, 5 mm off the middle",
        "frictionless/trail_y-0.20": "no friction, 10 mm off the middle",
        "friction_0.25/trail_y+0.10": "friction 0.25, 5 mm off the middle",
    }
    figure, panels = plt.subplots(
        1, 3, figsize=(PAGE, 2.5), sharex=True, sharey=True, layout="constrained"
    )
    lines = []
    for axes, (name, title) in zip(panels, names.items(), strict=True):
        found = vb.reconstruct(setup.rod, vb.read_recording(folder / f"{name}.csv", setup))
        truth = pd.read_csv(folder / f"{name}.truth.csv")
        point, touching = truth[["x", "y", "z"]].to_numpy(), truth.in_contact.to_numpy() == 1
        cells = []
        for label, colour, contacts in (
            ("sample by sample", RAW, found),
            ("smoothed", SMOOTH, vb.smooth(found)),
        ):
            both = touching & contacts.in_contact & (contacts.status == vb.Status.OK)
            error = contacts.point[both] - point[both]
            size = np.sort(1e3 * np.linalg.norm(error, axis=1))
            inside = np.mean(_squared(error, contacts.covariance[both]) < chi2.ppf(0.95, 3))
            axes.semilogx(size, np.linspace(0, 1, len(size)), color=colour, label=label)
            cells += [f"{np.median(size):.2f}", f"{np.quantile(size, 0.95):.2f}"]
            cells += [f"{100 * inside:.0f}"]
        lines.append([title, str(int(both.sum())), *cells])
        axes.set(xlabel="error of the contact point [mm]", xlim=(5e-3, 10), ylim=(0, 1))
        axes.set_title(title, fontsize=8)
        axes.grid(visible=True, color="0.9", linewidth=0.5)
    panels[0].set_ylabel("share of contacts")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    save_as(list(panels), IMAGES / "recordings.png")
    return {"recordings": lines}


def coverage() -> Numbers:
    """Share of true points inside the ellipsoids of every nominal probability, over rigs whose
    numbers are drawn from their tolerances.
    """
    sys.path.insert(0, str(HERE.parent / "benchmarks"))
    from tolerances import (  # noqa: PLC0415
        PARAMETERS,
        REST,
        ROD,
        SENSOR,
        TOLERANCES,
        logged,
        rig,
        sweeps,
    )

    warnings.simplefilter("ignore", vb.RecordingWarning)
    repeats, nominal = 40, np.linspace(0, 1, 101)
    factor = np.sqrt(np.diag(TOLERANCES.covariance))
    cases = {sweep.name: sweep for sweep in sweeps() if sweep.name in ("ball", "capsule")}
    _, panels = plt.subplots(
        1, 2, figsize=(0.75 * PAGE, 2.8), sharex=True, sharey=True, layout="constrained"
    )
    numbers: Numbers = {"coverage_sweeps": repeats * len(cases)}
    shares: dict[str, list[np.ndarray]] = {"raw": [], "smoothed": [], "noise": []}
    for sweep in cases.values():
        rng = np.random.default_rng(1)
        for _ in range(repeats):
            raw, scan = logged(sweep, rig(rng.normal(size=len(PARAMETERS)) * factor), rng)
            found = vb.reconstruct(ROD, SENSOR.reactions(raw, tolerances=TOLERANCES), friction=0.0)
            smooth = vb.smooth(found)
            for name, contacts, covariance in (
                ("raw", found, found.covariance),
                ("smoothed", smooth, smooth.covariance),
                ("noise", smooth, smooth.covariance_noise),
            ):
                row = np.flatnonzero(
                    (contacts.in_contact & (contacts.status == vb.Status.OK))[REST:]
                    & scan.in_contact
                )
                error = contacts.point[REST:][row] - scan.point[row]
                reached = chi2.cdf(_squared(error, covariance[REST:][row]), 3)
                shares[name].append(np.mean(reached[:, None] <= nominal, axis=0))
    titles = {"raw": "sample by sample", "smoothed": "smoothed"}
    for axes, (name, title) in zip(panels, titles.items(), strict=True):
        mean, spread = _mean(shares[name])
        colour = RAW if name == "raw" else SMOOTH
        axes.plot((0, 1), (0, 1), color="0.4", linewidth=0.7, linestyle="--", label="ideal")
        axes.fill_between(nominal, mean - 2 * spread, mean + 2 * spread, color=colour, alpha=0.25)
        axes.plot(nominal, mean, color=colour, label="tolerances stated")
        axes.set(title=title, xlabel="stated probability", xlim=(0, 1), ylim=(0, 1))
        axes.set_aspect("equal")
        axes.legend(loc="lower right")
    panels[0].set_ylabel("share of true points inside")
    save_as(list(panels), IMAGES / "coverage.png")
    for name, curves in shares.items():
        mean, spread = _mean(curves)
        numbers[f"coverage_{name}"] = f"{100 * mean[95]:.0f}"
        numbers[f"coverage_{name}_error"] = f"{100 * spread[95]:.0f}"
    return numbers


def _mean(curves: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Mean over sweeps, and its standard error."""
    return np.mean(curves, axis=0), np.std(curves, axis=0, ddof=1) / np.sqrt(len(curves))


def _squared(error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Errors (n, 3) in standard deviations, squared."""
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])


def _power(value: float) -> str:
    """A number of one digit, as a formula."""
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"${mantissa} \\cdot 10^{{{int(exponent)}}}$"


PARTS: dict[str, Callable[[], Numbers]] = {
    part.__name__: part for part in (oracle, engine, recordings, coverage)
}


def main(names: list[str]) -> Numbers:
    """Measure these parts, or all, and update the file of numbers."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    numbers = json.loads(NUMBERS.read_text(encoding="utf-8")) if NUMBERS.exists() else {}
    for name in names or PARTS:
        with journal():
            mpl.rcParams["savefig.dpi"] = 200
            numbers |= PARTS[name]()
        NUMBERS.write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
    return numbers


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1:]), indent=2))  # noqa: T201
