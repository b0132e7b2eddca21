"""Elastic lines along trails (paper, figure 3a)."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D

from vibrissa.contacts import ContactKind
from vibrissa.forward import Scan
from vibrissa.plot.style import COLUMN, KIND_COLOURS, KIND_NAMES, length_factor, length_label

_STRAIGHT = "black"


def elastic_lines(scan: Scan, *, every: int = 10, lanes: tuple[int, ...] | None = None) -> Axes3D:
    """The rod at every `every`-th position of some trails: red in tip contact, blue in tangential
    contact, black where it is straight.

    Parameters
    ----------
    scan
        Of several trails (m, n, …).
    every
        Positions from one line to the next.
    lanes
        Trails to show; all by default.
    """
    figure = plt.figure(figsize=(COLUMN * 1.5, COLUMN * 1.3))
    axes: Axes3D = figure.add_subplot(projection="3d", computed_zorder=False)
    factor = length_factor(scan.rod)
    for lane in range(len(scan.kind)) if lanes is None else lanes:
        clamp = factor * scan.trail.position[lane]
        axes.plot(*clamp.T, color="0.6", linewidth=0.6)
        for index in range(0, scan.trail.count, every):
            _rod(axes, scan, (lane, index), factor)
    for kind, colour in KIND_COLOURS.items():
        axes.plot([], [], [], color=colour, label=KIND_NAMES[kind])
    axes.plot([], [], [], color=_STRAIGHT, label="straight part")
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, 0.92), ncols=3, handlelength=1.4, columnspacing=1.2
    )
    dress(axes, scan)
    return axes


def _rod(axes: Axes3D, scan: Scan, at: tuple[int, int], factor: float) -> None:
    if not np.isfinite(scan.energy[at]):
        return
    kind = ContactKind(int(scan.kind[at]))
    count = 80
    line = factor * scan.elastic_line(at, count)
    if kind == ContactKind.NONE:
        axes.plot(*line.T, color=_STRAIGHT, linewidth=0.5)
        return
    s = np.linspace(0, scan.rod.length, count)
    bent = s <= scan.arc_length[at]
    axes.plot(*line[bent].T, color=KIND_COLOURS[kind], linewidth=0.7)
    if not bent.all():
        rest = np.vstack([factor * scan.point[at], line[~bent]])
        axes.plot(*rest.T, color=_STRAIGHT, linewidth=0.5)


def dress(axes: Axes3D, scan: Scan) -> None:
    """Labels, equal aspect, and a quiet background."""
    axes.set_xlabel(length_label("x", scan.rod), labelpad=2)
    axes.set_ylabel(length_label("y", scan.rod), labelpad=2)
    axes.set_zlabel(length_label("z", scan.rod), labelpad=-2)
    axes.set_aspect("equal")
    extents = [high - low for low, high in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())]
    axes.set_box_aspect(extents, zoom=1.0)
    axes.view_init(elev=24, azim=-52)
    axes.tick_params(pad=-1)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(nbins=4))
    for pane in (axes.xaxis, axes.yaxis, axes.zaxis):
        pane.set_pane_color((1, 1, 1, 0))
        pane._axinfo["grid"].update(color=(0.85, 0.85, 0.85, 1), linewidth=0.4)
