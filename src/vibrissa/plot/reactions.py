"""Support reactions over the clamp plane (paper, figure 2)."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import CenteredNorm
from matplotlib.ticker import MaxNLocator

from vibrissa.drawing import length_factor
from vibrissa.forward import Scan
from vibrissa.plot.style import PAGE, length_label

# Symbols, SI units, and the model's units.
_PANELS = [(f"f_{{0{axis}}}", "N", "$EI/L^2$") for axis in "xyz"]
_PANELS += [(f"m_{{0{axis}}}", "N m", "$EI/L$") for axis in "xyz"]


def reactions_over_plane(scan: Scan, *, skip: tuple[int, ...] = ()) -> list[Axes]:
    """Six panels, one per support reaction, coloured along trails over the clamp points (x0, y0).

    Parameters
    ----------
    scan
        Scan of several trails (m, n, …).
    skip
        Trails to leave out.

    Raises
    ------
    ValueError
        If the scan has only one trail.
    """
    if scan.kind.ndim != 2:
        raise ValueError(f"scan has the shape {scan.kind.shape}; allowed are several trails (m, n)")
    figure, grid = plt.subplots(2, 3, figsize=(PAGE, 2.7), sharex=True, sharey=True)
    figure.subplots_adjust(left=0.07, right=0.93, top=0.93, bottom=0.15, wspace=0.42, hspace=0.35)
    shown = np.delete(np.arange(len(scan.kind)), skip)
    clamp = length_factor(scan.rod) * scan.trail.position[shown, :, :2]
    pieces = np.stack([clamp[:, :-1], clamp[:, 1:]], axis=2)
    contact = scan.in_contact[shown]
    both = contact[:, :-1] & contact[:, 1:]
    values = scan.reactions.wrench[shown]
    for axes, (symbol, si, own), part in zip(
        grid.flat, _PANELS, np.moveaxis(values, -1, 0), strict=True
    ):
        largest = np.nanmax(np.abs(np.where(contact, part, 0.0)))
        axes.plot(*np.moveaxis(clamp, -1, 0).swapaxes(1, 2), color="0.8", linewidth=0.5, zorder=1)
        line = LineCollection(
            list(pieces[both]),
            array=((part[:, :-1] + part[:, 1:]) / 2)[both],
            cmap="RdBu_r",
            # A component that is zero gets the scale 1, not that of its rounding.
            norm=CenteredNorm(0.0, largest if largest > 1e-9 else 1.0),
            linewidth=5,
            capstyle="butt",
        )
        axes.add_collection(line)
        axes.set_title(f"${symbol}$ [{si if scan.rod.units == 'SI' else own}]")
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.margins(y=0.08)
        bar = plt.colorbar(line, cax=axes.inset_axes((1.03, 0, 0.045, 1)))
        bar.locator = MaxNLocator(nbins=5, symmetric=True)
        bar.update_ticks()
        bar.outline.set_linewidth(0.5)
    for axes in grid[-1]:
        axes.set_xlabel(length_label("x_0", scan.rod))
    for axes in grid[:, 0]:
        axes.set_ylabel(length_label("y_0", scan.rod))
    return list(grid.flat)
