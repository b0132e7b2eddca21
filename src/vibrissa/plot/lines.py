"""Elastic lines along trails (paper, figure 3a) and contact sequences on a surface (figure 3b)."""

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot as plt
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D

from vibrissa.contacts import ContactKind
from vibrissa.forward import Scan
from vibrissa.inverse import Reconstruction
from vibrissa.plot.style import COLUMN, KIND_COLOURS, KIND_NAMES, length_factor, length_label
from vibrissa.rod import Rod

_STRAIGHT = "black"
_POINTS = 80  # per elastic line: its segments are invisible at column width


def _space() -> Axes3D:
    figure = plt.figure(figsize=(COLUMN * 1.5, COLUMN * 1.3))
    return figure.add_subplot(projection="3d", computed_zorder=False)


def elastic_lines(scan: Scan, *, every: int = 10, lanes: tuple[int, ...] | None = None) -> Axes3D:
    """The rod at every `every`-th position of some trails: red in tip contact, blue in tangential
    contact, black where it is straight.

    Parameters
    ----------
    scan
        Scan of several trails (m, n, …).
    every
        Number of positions from one line to the next.
    lanes
        Trails to show; all by default.
    """
    axes, factor = _space(), length_factor(scan.rod)
    s = np.linspace(0, scan.rod.length, _POINTS)
    for lane in range(len(scan.kind)) if lanes is None else lanes:
        axes.plot(*factor * scan.trail.position[lane].T, color="0.6", linewidth=0.6)
        for index in range(0, scan.trail.count, every):
            at = lane, index
            if not np.isfinite(scan.energy[at]):
                continue
            line, kind = factor * scan.elastic_line(at, _POINTS), ContactKind(scan.kind[at])
            if kind in KIND_COLOURS:
                bent = s <= scan.arc_length[at]
                axes.plot(*line[bent].T, color=KIND_COLOURS[kind], linewidth=0.7)
                line = np.vstack([factor * scan.point[at], line[~bent]])
            axes.plot(*line.T, color=_STRAIGHT, linewidth=0.5)
    colours = {KIND_NAMES[kind]: colour for kind, colour in KIND_COLOURS.items()}
    for label, colour in (colours | {"straight part": _STRAIGHT}).items():
        axes.plot([], [], [], color=colour, label=label)
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, 0.92), ncols=3, handlelength=1.4, columnspacing=1.2
    )
    dress(axes, scan.rod)
    return axes


def contact_sequences(
    scan: Scan,
    found: Reconstruction,
    surface: tuple[Float[np.ndarray, "i j"], Float[np.ndarray, "i j"], Float[np.ndarray, "i j"]],
    *,
    skip: tuple[int, ...] = (),
) -> Axes3D:
    """Reconstructed contacts, one sequence per trail, over the object's surface.

    Parameters
    ----------
    scan, found
        The scan, for its trails and units, and the reconstruction from its reactions.
    surface
        Grids x, y, z of a patch of the surface, in units of the rod.
    skip
        Trails to leave out.
    """
    axes, factor = _space(), length_factor(scan.rod)
    grids = factor * np.stack(surface)
    axes.plot_surface(*grids, color="0.88", alpha=0.55, linewidth=0, rstride=1, cstride=1, zorder=1)
    axes.plot_wireframe(*grids, color="0.7", linewidth=0.25, rstride=6, cstride=6, zorder=2)
    shown = np.delete(np.arange(len(found.kind)), skip)
    for kind, colour in KIND_COLOURS.items():
        points = factor * found.point[shown][found.kind[shown] == kind]
        style = {"color": colour, "label": KIND_NAMES[kind], "s": 1.6, "linewidths": 0}
        axes.scatter(*points.T, depthshade=False, zorder=3, **style)
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, 0.95), ncols=2, markerscale=4, handletextpad=0.2
    )
    dress(axes, scan.rod)
    return axes


def dress(axes: Axes3D, rod: Rod) -> None:
    """Labels, equal aspect, and a quiet background."""
    for name, pad in (("x", 2), ("y", 2), ("z", -2)):
        getattr(axes, f"set_{name}label")(length_label(name, rod), labelpad=pad)
        axis = getattr(axes, f"{name}axis")
        axis.set_major_locator(MaxNLocator(nbins=4))
        axis.set_pane_color((1, 1, 1, 0))
        axis._axinfo["grid"].update(color=(0.85, 0.85, 0.85, 1), linewidth=0.4)
    axes.set_aspect("equal")
    axes.set_box_aspect(np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1))
    axes.view_init(elev=24, azim=-52)
    axes.tick_params(pad=-1)
