"""Maps of how well a sensor will do."""

from textwrap import fill

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.ticker import LogLocator

from vibrissa.contacts import Status
from vibrissa.design import ExpectedError
from vibrissa.drawing import length_factor
from vibrissa.plot.style import PAGE, length_label, status_words

_UNDETECTED, _MARKED = "0.8", "black"
# Letters in a line of the legend.
_WIDTH = 50
# Without the pale end of the map, which is lost on white paper.
_COLOURS = ListedColormap(plt.get_cmap("viridis_r")(np.linspace(0.1, 1.0, 256)))
# Height of a panel as a share of its width.
_LEAST_ASPECT = 0.4
# Smaller differences are not made to look large.
_LEAST_RATIO = 2.0
# Ratio of the ends of the colour bar below which more numbers are written.
_DECADE = 8.0
_COARSE = (1.0, 2.0, 5.0)
_FINE = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)


def expected_error_map(error: ExpectedError) -> list[Axes]:
    """The 95 % ellipsoids' longest semi-axis over the clamp positions and over the contact points,
    in the two world axes along which the clamp moves farthest.

    Positions without a detectable contact are grey; those where the sensor saturates have a black
    cross. Positions whose status is not OK have a black dot, and do not decide the colour scale
    unless there are no others.

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
    status = error.scan.status.ravel()
    flagged = seen & (status != Status.OK)
    low, high = np.quantile(
        longest[seen & ~flagged if flagged.sum() < seen.sum() else seen], [0, 0.98]
    )
    # An ellipsoid larger than the rod only says that nothing is known.
    high = max(min(high, factor * rod.length), _LEAST_RATIO * low)
    clamp, point = (
        factor * place.reshape(-1, 3) for place in (error.scan.trail.position, error.scan.point)
    )
    across = sorted(np.argsort(-np.ptp(clamp, axis=0), kind="stable")[:2].tolist())
    width, height = np.maximum(*(np.ptp(x[:, across], axis=0) for x in (clamp, point[seen])))
    figure, panels = plt.subplots(
        1,
        2,
        figsize=(PAGE, min(2.3 * max(height / width, _LEAST_ASPECT), 3.0) + 1.2),
        layout="constrained",
    )
    over, on = panels
    over.plot(*clamp[~seen][:, across].T, ".", color=_UNDETECTED, markersize=2)
    full = error.saturated.ravel() & seen
    for axes, flat in ((over, clamp[:, across].T), (on, point[:, across].T)):
        shown = axes.scatter(
            *flat[:, seen],
            c=longest[seen],
            norm=LogNorm(low, high),
            cmap=_COLOURS,
            s=9,
            linewidths=0,
        )
        axes.plot(*flat[:, flagged], ".", color=_MARKED, markersize=1.2, markeredgewidth=0)
        axes.plot(*flat[:, full], "x", color=_MARKED, markersize=3, markeredgewidth=0.5)
        axes.set_aspect("equal", adjustable="datalim")
    for axes, title, index in ((over, "clamp", "_0"), (on, "contact point", "")):
        names = [length_label("xyz"[axis] + index, rod) for axis in across]
        axes.set(title=f"over the {title}", xlabel=names[0], ylabel=names[1])
    words = (
        f"not detected ({(~seen).sum()})",
        fill(status_words(status[flagged]), _WIDTH),
        f"saturated ({full.sum()})",
    )
    counts = ((~seen).sum(), flagged.sum(), full.sum())
    named = {word: line for word, line, n in zip(words, over.lines, counts, strict=True) if n}
    if named:
        handles = list(named.values())
        figure.legend(handles, list(named), loc="outside lower left", ncols=2, markerscale=3)
    _colour_bar(shown, list(panels), "mm" if rod.units == "SI" else "L")
    return list(panels)


def _colour_bar(shown: PathCollection, panels: list[Axes], unit: str) -> None:
    """A bar with plain numbers, pointed where values lie beyond it."""
    figure, values, (low, high) = (
        panels[0].get_figure(root=True),
        shown.get_array(),
        shown.get_clim(),
    )
    assert figure is not None
    assert values is not None
    assert low is not None
    assert high is not None
    beyond = {(0, 0): "neither", (0, 1): "max", (1, 0): "min", (1, 1): "both"}
    bar = figure.colorbar(
        shown,
        ax=panels,
        label=f"longest semi-axis,\n95 % [{unit}]",
        extend=beyond[int(values.min() < low), int(values.max() > high)],
        aspect=14,
    )
    bar.ax.yaxis.set_major_locator(LogLocator(subs=_FINE if high < _DECADE * low else _COARSE))
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.ax.yaxis.set_minor_formatter("")
