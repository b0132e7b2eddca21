"""Support reactions over the clamp plane (paper, figure 2)."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import CenteredNorm
from matplotlib.ticker import MaxNLocator

from vibrissa.forward import Scan
from vibrissa.plot.style import PAGE, length_factor, length_label

_FORCES = ("f_{0x}", "f_{0y}", "f_{0z}")
_MOMENTS = ("m_{0x}", "m_{0y}", "m_{0z}")


def reactions_over_plane(scan: Scan, *, skip: tuple[int, ...] = ()) -> list[Axes]:
    """Six panels, one a support reaction, coloured along the trails over the clamp points (x0, y0).

    Parameters
    ----------
    scan
        Of several trails (m, n, …).
    skip
        Trails to leave out.

    Raises
    ------
    ValueError
        If the scan is of one trail.
    """
    if scan.kind.ndim != 2:
        raise ValueError(f"scan has the shape {scan.kind.shape}; allowed are several trails (m, n)")
    figure, grid = plt.subplots(2, 3, figsize=(PAGE, 2.7), sharex=True, sharey=True)
    figure.subplots_adjust(left=0.07, right=0.93, top=0.93, bottom=0.15, wspace=0.42, hspace=0.35)
    values = np.concatenate([scan.reactions.force, scan.reactions.moment], axis=-1)
    shown = [lane for lane in range(len(scan.kind)) if lane not in skip]
    panels = list(grid.ravel())
    for column, (axes, symbol) in enumerate(zip(panels, _FORCES + _MOMENTS, strict=True)):
        _panel(axes, scan, values[..., column], shown, _label(scan, symbol, column))
    for axes in grid[-1]:
        axes.set_xlabel(length_label("x_0", scan.rod))
    for axes in grid[:, 0]:
        axes.set_ylabel(length_label("y_0", scan.rod))
    return panels


def _label(scan: Scan, symbol: str, column: int) -> str:
    if scan.rod.units == "SI":
        return f"${symbol}$ [{'N' if column < 3 else 'N m'}]"
    return f"${symbol}$ [$EI/L^2$]" if column < 3 else f"${symbol}$ [$EI/L$]"


def _panel(axes: Axes, scan: Scan, values: np.ndarray, shown: list[int], label: str) -> None:
    factor = length_factor(scan.rod)
    largest = float(np.nanmax(np.abs(np.where(scan.in_contact, values, 0.0)[shown])))
    # A component that is zero gets a scale of its neighbours, not of its rounding.
    norm = CenteredNorm(0.0, largest if largest > 1e-9 else 1.0)
    for lane in shown:
        x, y = factor * scan.trail.position[lane, :, 0], factor * scan.trail.position[lane, :, 1]
        axes.plot(x, y, color="0.8", linewidth=0.5, zorder=1)
        points = np.column_stack([x, y])
        pieces = np.stack([points[:-1], points[1:]], axis=1)
        both = scan.in_contact[lane, :-1] & scan.in_contact[lane, 1:]
        line = LineCollection(
            list(pieces[both]),
            array=((values[lane, :-1] + values[lane, 1:]) / 2)[both],
            cmap="RdBu_r",
            norm=norm,
            linewidth=5,
            capstyle="butt",
        )
        axes.add_collection(line)
    axes.set_title(label)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(y=0.08)
    bar = plt.colorbar(line, cax=axes.inset_axes((1.03, 0, 0.045, 1)))
    bar.locator = MaxNLocator(nbins=5, symmetric=True)
    bar.update_ticks()
    bar.outline.set_linewidth(0.5)
