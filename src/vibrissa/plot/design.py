"""Maps of how well a sensor will do."""

from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from vibrissa.contacts import Status
from vibrissa.design import ExpectedError
from vibrissa.drawing import length_factor
from vibrissa.plot.arguments import checked
from vibrissa.plot.style import COLUMN, PAGE, length_label, status_words

_FREE, _UNDETECTED, _MARKED = "0.8", "#d55e00", "black"
# Letters in a line of the legend.
_WIDTH = 50
# Without the pale end of the map, which is lost on white paper.
_COLOURS = ListedColormap(plt.get_cmap("viridis_r")(np.linspace(0.1, 1.0, 256)))
# Height of a panel as a share of its width.
_LEAST_ASPECT = 0.4
# In rod lengths: a clamp that moves less stands.
_STILL = 1e-9
# Smaller differences are not made to look large.
_LEAST_RATIO = 2.0
# Ratio of the ends of the colour bar below which more numbers are written.
_DECADE = 8.0
_COARSE = (1.0, 2.0, 5.0)
_FINE = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)


class _Mark(NamedTuple):
    """Positions that are drawn alike, whatever their error."""

    rows: Bool[np.ndarray, "n"]
    marker: str
    colour: str
    size: float
    label: str


@checked
def expected_error_map(error: ExpectedError) -> list[Axes]:
    """The 95 % ellipsoids' longest semi-axis over the clamp positions and over the contact points,
    in the two world axes along which the clamp moves farthest; if the clamp stands, over the
    contact points only.

    Positions without contact are grey, contacts that are not detected are orange, and those where
    the sensor saturates have a black cross. Positions whose status is not OK have a black dot, and
    do not decide the colour scale unless there are no others.

    Parameters
    ----------
    error
        Result of `vibrissa.expected_error`.

    Returns
    -------
    list of Axes
        Over the clamp positions, unless the clamp stands, and over the contact points.

    Raises
    ------
    ValueError
        If no contact is detected anywhere.
    """
    rod, factor = error.scan.rod, length_factor(error.scan.rod)
    longest = factor * error.semi_axes[..., -1].ravel()
    seen = error.detected.ravel() & np.isfinite(longest)
    if not seen.any():
        raise ValueError(
            "no contact of the scan is detected; allowed is a scan with a contact whose load "
            "exceeds the sensor's noise"
        )
    flagged = seen & (error.scan.status.ravel() != Status.OK)
    low, high = np.quantile(
        longest[seen & ~flagged if flagged.sum() < seen.sum() else seen], [0, 0.98]
    )
    # An ellipsoid larger than the rod only says that nothing is known.
    high = max(min(high, factor * rod.length), _LEAST_RATIO * low)
    clamp, point = (
        factor * place.reshape(-1, 3) for place in (error.scan.trail.position, error.scan.point)
    )
    places = {"clamp": clamp, "contact point": point}
    if np.ptp(clamp, axis=0).max() < _STILL * factor * rod.length:
        del places["clamp"]
    extents = [np.nanmax(place, axis=0) - np.nanmin(place, axis=0) for place in places.values()]
    across = sorted(np.argsort(-extents[0], kind="stable")[:2].tolist())
    figure, panels = _panels(np.max(extents, axis=0)[across], len(places))
    marks = [mark for mark in _marks(error, seen, flagged) if mark.rows.any()]
    for axes, (name, place) in zip(panels, places.items(), strict=True):
        x, y = place[:, across].T
        shown = axes.scatter(
            x[seen], y[seen], c=longest[seen], norm=LogNorm(low, high), cmap=_COLOURS, s=9,
            linewidths=0,
        )  # fmt: skip
        for rows, marker, colour, size, label in marks:
            edge = 0.5 if marker == "x" else 0
            style: dict[str, Any] = {
                "color": colour,
                "markersize": size,
                "markeredgewidth": edge,
                "label": label,
            }
            axes.plot(x[rows], y[rows], marker, **style)
        axes.set_aspect("equal", adjustable="datalim")
        symbols = ["xyz"[axis] + "_0" * (name == "clamp") for axis in across]
        labels = [length_label(symbol, rod) for symbol in symbols]
        axes.set(title=f"over the {name}", xlabel=labels[0], ylabel=labels[1])
    if marks:
        handles = panels[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower left", ncols=2, markerscale=3)
    _colour_bar(shown, panels, "mm" if rod.units == "SI" else "L")
    return panels


def _marks(
    error: ExpectedError, seen: Bool[np.ndarray, "n"], flagged: Bool[np.ndarray, "n"]
) -> list[_Mark]:
    """What is said of positions beside their error, with its count."""
    touching = error.scan.in_contact.ravel()
    missed, full = touching & ~seen, seen & error.saturated.ravel()
    words = fill(status_words(error.scan.status.ravel()[flagged]), _WIDTH)
    return [
        _Mark(~touching, ".", _FREE, 2, f"no contact ({np.sum(~touching)})"),
        _Mark(missed, ".", _UNDETECTED, 3.5, f"contact not detected ({missed.sum()})"),
        _Mark(flagged, ".", _MARKED, 1.2, words),
        _Mark(full, "x", _MARKED, 3, f"saturated ({full.sum()})"),
    ]


def _panels(extent: Float[np.ndarray, "2"], count: int) -> tuple[Figure, list[Axes]]:
    """Panels side by side, about as high as what they hold."""
    wide, high = extent.tolist()
    each = (
        2.3 * _LEAST_ASPECT if high <= _LEAST_ASPECT * wide else 3.0 / max(1.0, 1.3 * wide / high)
    )
    width = PAGE if count > 1 else COLUMN + 1.0
    figure, panels = plt.subplots(
        1, count, figsize=(width, each + 1.2), layout="constrained", squeeze=False
    )
    return figure, list(panels[0])


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
