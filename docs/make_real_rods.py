"""Measure what docs/real_rods.md says, and draw its figure: `python docs/make_real_rods.py`.

A wire is swept under the paper's bowl with wind, warmth, weight, a soft support, taper or rest
curvature, and its contacts are reconstructed twice: as if it were plain, and with the rod as it is.
The numbers go to docs/real_rods.json, from which the page takes them.
"""

import json
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

mpl.use("Agg")

import vibrissa as vb
from vibrissa.mechanics.model import AT_ORIGIN
from vibrissa.mechanics.models import model_of
from vibrissa.plot import journal, save_as
from vibrissa.plot.style import PAGE

HERE = Path(__file__).parent
NUMBERS, FIGURE = HERE / "real_rods.json", HERE / "images" / "real_rods.png"
LENGTH, RADIUS, REFERENCE = 0.08, 0.25e-3, 20.0
WIRE = vb.rods.spring_steel(LENGTH, RADIUS)
BOWL = vb.surfaces.EllipticParaboloid(a=0.5 / LENGTH, b=1 / LENGTH, h=0.4 * LENGTH)
TRAIL = vb.Trail.line(start=(0.09, 0.2 * LENGTH, 0), stop=(-0.09, 0.2 * LENGTH, 0), count=241)
ROLL = np.pi / 4
FORCE_NOISE, TORQUE_NOISE = 1 / 320, 1e-3 / 64
"""Of the finest calibration of the ATI Nano17 [N], [N m]: `vibrissa.sensor.presets`."""
RATE = 50.0
MEDIAN, LARGEST = "#1d5fa8", "#c1121f"


class Effect(NamedTuple):
    """One cause, at some sizes in the unit of its label."""

    label: str
    sizes: tuple[float, ...]
    rod: Callable[[float], vb.Rod]
    assumed: Callable[[float], vb.Rod] = lambda _: WIRE
    tared: bool = True
    """Whether the sensor is set to zero while the cause is there."""


def _tapered(percent: float) -> vb.Rod:
    return vb.Rod.tapered(
        length=LENGTH,
        base_radius=RADIUS,
        tip_radius=RADIUS * (1 - percent / 100),
        youngs_modulus=206e9,
        density=7850.0,
        poisson_ratio=WIRE.poisson_ratio,
    )


def _blown(speed: float) -> vb.Rod:
    return WIRE.loaded(vb.Loads(wind=(0.0, speed, 0.0)))


def _wire(diameter: float) -> vb.Rod:
    return vb.rods.spring_steel(LENGTH, 0.5e-3 * diameter)


EFFECTS = {
    "wind": Effect("wind across [m/s]", (1.0, 2.0, 5.0, 10.0, 20.0), _blown, tared=False),
    "tared_wind": Effect("steady wind, tared [m/s]", (1.0, 2.0, 5.0, 10.0, 20.0), _blown),
    "weight": Effect(
        "diameter of the level wire [mm]",
        (0.1, 0.2, 0.3, 0.5, 1.0),
        lambda size: _wire(size).loaded(vb.Loads(gravity=(0.0, -9.81, 0.0))),
        _wire,
    ),
    "temperature": Effect(
        "warmer than calibrated by [K]",
        (1.0, 3.0, 10.0, 30.0, 100.0),
        lambda rise: WIRE.at(temperature=REFERENCE + rise),
    ),
    "support": Effect(
        "support yields [mrad per N mm]",
        (0.1, 0.3, 1.0, 3.0, 10.0),
        lambda soft: WIRE.on(vb.Support.pivot((1 / soft,) * 3)),
    ),
    "taper": Effect("tip thinner by [%]", (0.3, 1.0, 3.0, 10.0, 30.0), _tapered),
    "curvature": Effect(
        "tip off the straight line at rest [mm]",
        (0.03, 0.1, 0.3, 1.0, 3.0),
        lambda off: WIRE.curved(vb.RestShape.arc(LENGTH**2 / (2e-3 * off), roll=ROLL)),
    ),
}


def measured(effect: Effect, size: float) -> dict[str, Any]:
    """Errors [% of L] of the contacts as if the rod were plain and as it is, and what the plain
    reconstruction says of itself.
    """
    rod, plain = effect.rod(size), effect.assumed(size)
    scan = vb.scan(rod, BOWL, TRAIL)
    free = np.asarray(model_of(rod).free(AT_ORIGIN).reactions)
    zero = free if effect.tared else np.zeros(6)
    units = np.repeat([rod.force_scale, rod.moment_scale], 3)
    force, moment = (
        part - own for part, own in zip(_felt(scan), np.split(zero * units, 2), strict=True)
    )
    sensed = vb.Reactions(scan.trail, force, moment)
    rows = scan.in_contact & (scan.status == vb.Status.OK)

    def error(found: vb.Reconstruction) -> np.ndarray:
        off = np.linalg.norm(found.point - scan.point, axis=1)[rows]
        return 100 / LENGTH * off[np.isfinite(off)]

    as_plain = vb.reconstruct(plain, sensed, friction=0.0)
    right = error(vb.reconstruct(rod, scan.reactions, friction=0.0))
    wrong = error(as_plain)
    told = _told(plain, sensed)
    return {
        "size": size,
        "median": float(np.median(wrong)),
        "largest": float(np.max(wrong)),
        "corrected": float(np.max(right)),
        "rows": int(rows.sum()),
        "corrected_rows": len(right),
        "marked": float(np.mean(told.status[rows] != vb.Status.OK)),
        "warnings": told.warnings,
    }


def _felt(scan: vb.Scan) -> tuple[np.ndarray, np.ndarray]:
    return scan.reactions.force, scan.reactions.moment


def _told(plain: vb.Rod, sensed: vb.Reactions) -> vb.Reconstruction:
    """The contacts of a recording of a fine sensor at 50 Hz."""
    deviations = np.repeat([FORCE_NOISE, TORQUE_NOISE], 3)
    noise = np.random.default_rng(1).normal(size=(len(sensed.force), 6)) * deviations
    recorded = vb.Reactions(
        sensed.trail,
        sensed.force + noise[:, :3],
        sensed.moment + noise[:, 3:],
        time=np.arange(len(noise)) / RATE,
        covariance=np.diag(deviations**2),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return vb.reconstruct(plain, recorded, friction=0.0)


def _draw(found: dict[str, list[dict[str, Any]]]) -> None:
    figure, panels = plt.subplots(2, 3, figsize=(PAGE, 4.2), sharey=True, layout="constrained")
    shown = {name: rows for name, rows in found.items() if name != "tared_wind"}
    for axes, (name, rows) in zip(panels.flat, shown.items(), strict=True):
        sizes = [row["size"] for row in rows]
        for key, paint, marker in (("largest", LARGEST, "o"), ("median", MEDIAN, "s")):
            axes.loglog(
                sizes,
                [row[key] for row in rows],
                marker + "-",
                color=paint,
                markersize=4,
                label=key,
            )
        if name == "wind":
            tared = [row["median"] for row in found["tared_wind"]]
            axes.loglog(sizes, tared, "s--", color=MEDIAN, markersize=4, markerfacecolor="white",
                        label="median, sensor tared in the wind")  # fmt: skip
        axes.set_xlabel(EFFECTS[name].label)
        axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
        axes.xaxis.set_minor_locator(mpl.ticker.NullLocator())
        axes.grid(visible=True, color="0.9", linewidth=0.5)
        axes.set_ylim(3e-3, 1e2)
    for axes in panels[:, 0]:
        axes.set_ylabel("error of the contact [% of $L$]")
    handles, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=3)
    save_as(panels.ravel().tolist(), FIGURE)


def main(names: list[str]) -> None:
    """Measure the effects with these names, or all."""
    found = json.loads(NUMBERS.read_text(encoding="utf-8")) if NUMBERS.exists() else {}
    for name, effect in EFFECTS.items():
        if names and name not in names:
            continue
        found[name] = [measured(effect, size) for size in effect.sizes]
        for row in found[name]:
            print(name, row, flush=True)  # noqa: T201
        ordered = {key: found[key] for key in EFFECTS if key in found}
        NUMBERS.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
    if len(found) == len(EFFECTS):
        with journal():
            mpl.rcParams["savefig.dpi"] = 200
            _draw({key: found[key] for key in EFFECTS})


if __name__ == "__main__":
    main(sys.argv[1:])
