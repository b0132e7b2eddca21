"""Draw the diagrams of the pages: `uv run python docs/make_diagrams.py [NAME ...]` writes them into
docs/images/pages.
"""

import sys
import tomllib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

import vibrissa as vb
from vibrissa.plot import journal, save_as
from vibrissa.plot.style import COLUMN, PAGE

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images" / "pages"
INK, RED, BLUE, GREEN, SAND = "0.15", "#c1121f", "#1d5fa8", "#2a7f3f", "#f4ead5"
PALE = {"data": "#e8eef6", "step": SAND, "file": "#eef3ea"}


def clocks() -> Axes:
    """How poses at their own rate are brought to the stamps of the wrenches."""
    _, axes = plt.subplots(figsize=(PAGE, 1.7), layout="constrained")
    wrench, poses = np.arange(0, 1.001, 0.02), np.array([*np.arange(0.1, 0.5, 0.07), 0.78, 0.85])
    before, gap = wrench < poses[0], (wrench > poses[5]) & (wrench < 0.78)
    after = wrench > poses[-1]
    kinds = [
        (before | after, "0.75", "left out: no pose before or after"),
        (gap, RED, "in a gap: no reactions (BAD_DATA)"),
        (~(before | gap | after), BLUE, "wrench with interpolated pose"),
    ]
    for rows, colour, label in reversed(kinds):
        axes.plot(wrench[rows], np.ones(rows.sum()), "o", color=colour, markersize=4, label=label)
    axes.plot(poses, np.zeros(len(poses)), "s", color=INK, markersize=5, label="pose")
    axes.axvspan(poses[5], 0.78, color=RED, alpha=0.08, linewidth=0)
    arrow = {"arrowstyle": "<->", "color": INK, "linewidth": 0.7}
    axes.annotate("", (poses[5], 0.45), (0.78, 0.45), arrowprops=arrow)
    axes.text(0.615, 0.5, "more than longest_gap", ha="center", va="bottom", fontsize=8)
    for stamp in wrench[(wrench > poses[1]) & (wrench < poses[2])]:
        for pose in poses[1:3]:
            axes.plot((pose, stamp), (0.08, 0.92), color="0.6", linewidth=0.5)
    axes.set(yticks=(0, 1), yticklabels=("robot", "sensor"), ylim=(-0.4, 1.4), xlim=(-0.02, 1.02))
    axes.set_xlabel("time on the clock of the wrenches [s]: stamps of poses + time_offset")
    axes.spines[["left", "top", "right"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.figure.legend(loc="outside upper center", ncols=4, handletextpad=0.2, columnspacing=1.2)
    return axes


def elastica() -> Axes:
    """The symbols of the mechanics, on a computed shape in the plane of bending."""
    ball = vb.surfaces.Sphere(center=(0, 0, 1.15), radius=0.6)
    trail = vb.Trail.line(start=(0.8, 0, 0), stop=(-0.4, 0, 0), count=121)
    scan = vb.scan(vb.Rod.unit(), ball, trail)
    row = int(np.argmin(np.abs(trail.position[:, 0] + 0.02)))
    line, clamp = scan.elastic_line(row)[:, ::2], scan.trail.position[row, ::2]
    touch, normal = scan.point[row, ::2], scan.normal[row, ::2]
    across = np.array([-normal[1], normal[0]])
    foot = clamp + ((touch - clamp) @ across) * across
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    bent = arc <= scan.arc_length[row]

    _, axes = plt.subplots(figsize=(1.4 * COLUMN, 1.15 * COLUMN), layout="constrained")
    turn = np.linspace(0, 2 * np.pi, 400)
    axes.fill(0.6 * np.cos(turn), 1.15 + 0.6 * np.sin(turn), color="0.9", linewidth=0)
    axes.plot(*line[bent].T, color=BLUE, linewidth=2)
    axes.plot(*line[~bent].T, color=INK, linewidth=2)
    ends = touch - 0.3 * normal, min(foot, touch, key=lambda end: end[1]) + 0.2 * normal
    axes.plot(*np.transpose(ends), color=RED, linewidth=0.7, linestyle="--")
    axes.plot(*np.transpose([clamp, foot]), color=GREEN, linewidth=1)
    axes.fill_between((clamp[0] - 0.05, clamp[0] + 0.05), -0.09, 0, color=INK, linewidth=0)
    _arrow(axes, clamp, clamp + (0, 0.2), INK)
    _arrow(axes, touch, touch + 0.25 * normal, RED)
    for point in (clamp, touch):
        axes.plot(*point, "o", color=INK, markersize=4, zorder=5)
    for text, place, shift, colour in (
        ("clamp $P_0$", clamp, (16, -12), INK),
        ("$t_0$", clamp + (0, 0.2), (-14, -4), INK),
        ("$P_1$", touch, (-4, 8), INK),
        (r"$F = f\,\hat{n}$", touch + 0.25 * normal, (6, 2), RED),
        (r"$\ell = \|m_0\|/f$", (clamp + foot) / 2, (4, -12), GREEN),
        ("arc length $s_1$ from $P_0$ to $P_1$", line[np.searchsorted(arc, 0.4)], (-132, 6), BLUE),
        ("straight to the tip", line[-1], (6, -2), INK),
        ("object: $g(p) < 0$", np.array([-0.3, 1.05]), (0, 0), "0.35"),
        ("line of the force", ends[1], (5, -6), RED),
    ):
        axes.annotate(text, place, xytext=shift, textcoords="offset points", color=colour)
    axes.set(aspect="equal", xlim=(-0.85, 1.05), ylim=(-0.2, 1.3))
    axes.axis("off")
    return axes


def _arrow(axes: Axes, start: np.ndarray, stop: np.ndarray, colour: str) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", stop, start, arrowprops=style, zorder=6)


class Box(NamedTuple):
    """A box of a chart: where its middle is, what it says, and what it is."""

    x: float
    y: float
    text: str
    kind: str = "data"


def _chart(
    boxes: dict[str, Box], arrows: list[tuple[str, str, str]], size: tuple[float, float]
) -> Axes:
    """Boxes, and arrows between them with labels."""
    _, axes = plt.subplots(figsize=size, layout="constrained")
    drawn = {}
    for name, box in boxes.items():
        look = {"boxstyle": "round,pad=0.45", "facecolor": PALE[box.kind], "edgecolor": "0.55"}
        drawn[name] = axes.text(
            box.x, box.y, box.text, ha="center", va="center", fontsize=8.5, bbox=look | {"lw": 0.7}
        )
    for start, stop, label in arrows:
        one, other = boxes[start], boxes[stop]
        patches = {"patchA": drawn[start].get_bbox_patch(), "patchB": drawn[stop].get_bbox_patch()}
        style = {"arrowstyle": "-|>", "color": INK, "lw": 0.9, "shrinkA": 1, "shrinkB": 1}
        axes.annotate("", (other.x, other.y), (one.x, one.y), arrowprops=style | patches)
        upright = one.x == other.x
        axes.annotate(
            label,
            ((one.x + other.x) / 2, (one.y + other.y) / 2),
            xytext=(5, 0) if upright else (0, 3),
            textcoords="offset points",
            ha="left" if upright else "center",
            va="center" if upright else "bottom",
            fontsize=7.5,
            color="0.3",
        )
    places = np.array([(box.x, box.y) for box in boxes.values()])
    low, high = places.min(axis=0), places.max(axis=0)
    axes.set(xlim=(low[0] - 0.8, high[0] + 0.8), ylim=(low[1] - 0.5, high[1] + 0.5))
    axes.axis("off")
    return axes


def api() -> Axes:
    """Which function leads from what to what."""
    boxes = {
        "parts": Box(0, 2, "Rod, surfaces.*, Trail"),
        "scan": Box(2.4, 2, "Scan"),
        "error": Box(4.8, 2, "ExpectedError"),
        "log": Box(0, 1, "your log\n+ setup.toml", "file"),
        "reactions": Box(2.4, 1, "Reactions"),
        "calibration": Box(4.8, 1, "Calibration"),
        "found": Box(2.4, 0, "Reconstruction"),
        "contacts": Box(4.8, 0, "Contacts"),
        "out": Box(0, 0, "files, figures", "file"),
    }
    arrows = [
        ("parts", "scan", "scan"),
        ("scan", "error", "Sensor, expected_error"),
        ("scan", "reactions", ".reactions, Sensor.measure"),
        ("log", "reactions", "read_recording"),
        ("reactions", "calibration", "calibrate"),
        ("reactions", "found", "reconstruct, smooth"),
        ("found", "contacts", ".contacts"),
        ("found", "out", "write_contacts, plot.*"),
    ]
    return _chart(boxes, arrows, (PAGE, 2.5))


def live() -> Axes:
    """From sources to sinks."""
    boxes = {
        "netft": Box(0, 2, "sensor: RDT over UDP", "file"),
        "lines": Box(0, 1, "CSV lines: TCP, serial", "file"),
        "replay": Box(0, 0, "replay of a recording", "file"),
        "clock": Box(1.9, 1, "clock,\nlost samples", "step"),
        "pose": Box(1.9, 2, "pose: UDP,\ntrail, constant", "file"),
        "tare": Box(3.1, 1, "tare,\nreactions", "step"),
        "contacts": Box(4.3, 1, "contacts,\nsmoothing", "step"),
        "mcap": Box(6.1, 2, "MCAP, rosbag2", "file"),
        "jsonl": Box(6.1, 1, "JSON lines, PLY", "file"),
        "own": Box(6.1, 0, "your own function", "file"),
    }
    arrows = [(name, "clock", "") for name in ("netft", "lines", "replay")]
    arrows += [("clock", "tare", ""), ("pose", "tare", ""), ("tare", "contacts", "")]
    arrows += [("contacts", name, "") for name in ("mcap", "jsonl", "own")]
    return _chart(boxes, arrows, (PAGE, 2.0))


def walk() -> Axes:
    """One position forward, one sample inverse."""
    forward = (
        "trail, object, rod",
        "where does the\nstraight rod touch?",
        "march, Newton\nat each position",
    )
    forward += ("snaps, events", "reactions,\nchecks: Scan")
    inverse = (
        "log",
        "columns,\nunits, clocks",
        "tare, mount:\nreactions",
        "most probable\nsingle contact",
    )
    inverse += ("check of the setup:\nReconstruction",)
    boxes, arrows = {}, []
    for y, names in ((1, forward), (0, inverse)):
        for x, name in enumerate(names):
            kind = "data" if x in (0, len(names) - 1) else "step"
            boxes[name] = Box(1.5 * x, y, name, kind)
        arrows += [(one, other, "") for one, other in pairwise(names)]
    return _chart(boxes, arrows, (PAGE, 1.6))


def rooms() -> Axes:
    """The import contract, as a house."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contracts = tomllib.loads(text)["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    _, axes = plt.subplots(figsize=(PAGE, 0.27 * len(layers)), layout="constrained")
    for y, layer in enumerate(reversed(layers)):
        names = [name.strip() for name in layer.replace(":", "|").split("|")]
        for x, name in enumerate(names):
            width = 1 / len(names)
            axes.barh(y, width, left=x * width, height=0.86, color=PALE["data"], edgecolor="white")
            axes.text((x + 0.5) * width, y, name, ha="center", va="center", fontsize=8.5)
    axes.annotate("", (1.03, -0.4), (1.03, len(layers) - 0.6), arrowprops={"arrowstyle": "-|>"})
    axes.text(1.05, len(layers) / 2 - 0.5, "may import", rotation=270, va="center", fontsize=8.5)
    axes.set(xlim=(0, 1.09), ylim=(-0.6, len(layers) - 0.4))
    axes.axis("off")
    return axes


DRAWN: dict[str, Callable[[], Axes]] = {
    drawing.__name__: drawing for drawing in (clocks, elastica, api, live, walk, rooms)
}


def main(names: list[str]) -> None:
    """Draw these, or all."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    for name in names or DRAWN:
        with journal():
            mpl.rcParams["savefig.dpi"] = 200
            save_as(DRAWN[name](), IMAGES / f"{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
