"""Maps of how well a sensor will do."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.ticker import LogLocator

from vibrissa.design import ExpectedError
from vibrissa.plot.style import PAGE, length_factor, length_label

_UNDETECTED, _SATURATED = "0.8", "black"
# Without the pale end of the map, which is lost on white paper.
_COLOURS = ListedColormap(plt.get_cmap("viridis_r")(np.linspace(0.1, 1.0, 256)))
_LEAST_ASPECT = 0.4
_DECADE = 8.0
_FINE = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)


def expected_error_map(error: ExpectedError) -> list[Axes]:
    """The 95 % ellipsoids' longest semi-axis over the clamp positions and over the contact points,
    in the two world axes along which the clamp moves farthest.

    Positions without a detectable contact are grey; those where the sensor saturates have a black
    cross.

    Parameters
    ----------
    error
        Result of `vibrissa.expected_error`.

    Raises
    ------
    ValueError
        If no contact is detected anywhere.
    """
    rod = error.scan.rod
    factor = length_factor(rod)
    longest = factor * error.semi_axes[..., -1].ravel()
    seen = error.detected.ravel() & np.isfinite(longest)
    if not seen.any():
        raise ValueError(
            "no contact of the scan is detected; allowed is a scan with a contact whose load "
            "exceeds the sensor's noise"
        )
    places = [
        factor * place.reshape(-1, 3) for place in (error.scan.trail.position, error.scan.point)
    ]
    across = sorted(np.argsort(-np.ptp(places[0], axis=0), kind="stable")[:2].tolist())
    low, high = np.quantile(longest[seen], [0.0, 0.98])
    # An ellipsoid larger than the rod only says that nothing is known.
    high = max(min(high, factor * rod.length), 1.01 * low)
    norm = LogNorm(low, high)
    full = error.saturated.ravel() & seen
    shown = np.stack([place[seen][:, across] for place in places])
    width, height = np.maximum(
        np.ptp(shown, axis=1).max(axis=0), np.ptp(places[0][:, across], axis=0)
    )
    figure, panels = plt.subplots(
        1,
        2,
        figsize=(PAGE, min(2.3 * max(height / width, _LEAST_ASPECT), 3.0) + 1.2),
        layout="constrained",
    )
    for axes, place, title, index in zip(
        panels, places, ("clamp", "contact point"), ("_0", ""), strict=True
    ):
        flat = place[:, across].T
        if title == "clamp" and not seen.all():
            count = np.count_nonzero(~seen)
            grey = {"color": _UNDETECTED, "markersize": 2, "label": f"not detected ({count})"}
            axes.plot(*flat[:, ~seen], ".", **grey)
        style = {"norm": norm, "cmap": _COLOURS, "s": 9, "linewidths": 0}
        points = axes.scatter(*flat[:, seen], c=longest[seen], **style)
        if full.any():
            cross = {"color": _SATURATED, "markersize": 3, "markeredgewidth": 0.5}
            label = f"saturated ({np.count_nonzero(full)})"
            axes.plot(*flat[:, full], "x", label=label, **cross)
        names = [length_label("xyz"[axis] + index, rod) for axis in across]
        axes.set(title=f"over the {title}", xlabel=names[0], ylabel=names[1])
        axes.set_aspect("equal", adjustable="datalim")
    handles, labels = panels[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower left", ncols=2, markerscale=3)
    unit = "[mm]" if rod.units == "SI" else "$/L$"
    label = f"longest semi-axis,\n95 % {unit}"
    bar = figure.colorbar(points, ax=list(panels), label=label, extend="max", aspect=14)
    narrow = high < _DECADE * low
    bar.ax.yaxis.set_major_locator(LogLocator(subs=_FINE if narrow else (1.0, 2.0, 5.0)))
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.ax.yaxis.set_minor_formatter("")
    return list(panels)
