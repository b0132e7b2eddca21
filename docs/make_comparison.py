"""Measure what docs/compare.md says of times, and draw its figure, on one core: `python
docs/make_comparison.py`, with the dependency group `benchmark`.

Every peer's contacts are checked against the package's before its time counts. The numbers go to
docs/comparison.json, from which the page takes them.
"""

import json
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from timing import pin_to_one_core

if __name__ == "__main__":
    pin_to_one_core()

import mujoco
import numpy as np
import scipy
from matplotlib import pyplot as plt

import vibrissa as vb
from chains import CENTER, RADIUS, REST, ROD, TRAIL, ball_geom, chain, compared, hinges, settled
from vibrissa.plot import journal, save_as
from warm import forward

HERE = Path(__file__).parent
SEGMENTS = (10, 20, 40)
OWN, SCIPY, ENGINE = "#1d5fa8", "#c77700", "#8a8a8a"


def main() -> dict[str, str]:
    """Milliseconds per static position, and the engine's differences."""
    batch, one, bvp, exact, shooting = (row.microseconds / 1e3 for row in forward())
    sphere = vb.surfaces.Sphere(center=CENTER, radius=RADIUS)
    scan = vb.scan(ROD, sphere, TRAIL, finite_radius=True)
    bars = [("vibrissa, in a batch", batch, OWN), ("vibrissa, one sweep", one, OWN)]
    bars += [("SciPy solve_bvp, our Jacobians", exact, SCIPY), ("SciPy solve_bvp", bvp, SCIPY)]
    bars += [("SciPy shooting", shooting, SCIPY)]
    numbers = {"scipy_version": scipy.__version__, "mujoco_version": mujoco.__version__}
    names = ("batch", "one", "exact", "bvp", "shooting")
    numbers |= {name: _short(bar[1]) for name, bar in zip(names, bars, strict=True)}
    for count in SEGMENTS:
        model = mujoco.MjModel.from_xml_string(chain(count, hinges, ball_geom()))
        found = settled(model, TRAIL.position / ROD.length, REST / count)
        force = float(np.median(compared(scan, found)["force"]))
        bars.append((f"MuJoCo, {count} segments", found.microseconds / 1e3, ENGINE))
        numbers[f"chain_{count}"] = _short(found.microseconds / 1e3)
        numbers[f"chain_{count}_force"] = f"{100 * force:.1g}"
    with journal():
        mpl.rcParams["savefig.dpi"] = 200
        _draw(bars)
    return numbers


def _draw(bars: list[tuple[str, float, str]]) -> None:
    _, axes = plt.subplots(figsize=(5.2, 2.5), layout="constrained")
    names, times, colours = zip(*bars, strict=True)
    axes.hlines(names, 1e-3, times, color="0.85", linewidth=1)
    axes.scatter(times, names, color=colours, s=28, zorder=3)
    for row, time in enumerate(times):
        axes.annotate(f"   {_short(time)} ms", (time, row), va="center", fontsize=8)
    axes.set(xscale="log", xlabel="time for one static position [ms]", xlim=(1e-3, 60))
    axes.invert_yaxis()
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    target = HERE / "images" / "compare" / "times.png"
    target.parent.mkdir(exist_ok=True)
    save_as(axes, target)


def _short(value: float) -> str:
    """Two digits: on a shared machine the rest is chance."""
    return f"{float(f'{value:.2g}'):g}"


if __name__ == "__main__":
    measured = main()
    (HERE / "comparison.json").write_text(json.dumps(measured, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(measured, indent=2))  # noqa: T201
