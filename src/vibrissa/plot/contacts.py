"""Reconstructed contacts of a recording, in three views."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from vibrissa.contacts import Status
from vibrissa.drawing import KIND_COLOURS, KIND_NAMES, length_factor
from vibrissa.inverse import Reconstruction
from vibrissa.plot.arguments import checked
from vibrissa.plot.style import PAGE, length_label, no_contact, status_words

# Square root of the 95 % quantile of χ² with two degrees of freedom.
_TWO_DIMENSIONS_95 = 2.4477
_VIEWS = ([0, 1], [2, 1], [0, 2])
# More would hide the contacts that they belong to.
_ELLIPSES, _WIDE_ELLIPSES = 15, 6
_ELLIPSE_COLOUR, _FAINT = "0.25", 0.4
_FLAGGED_COLOUR = "#c77700"
# Per cent of the untrusted contacts at each end that do not widen the frame.
_TAIL = 5.0
_MARGIN = 0.06
# Share of the reach, so that a single contact is not magnified without limit.
_LEAST_FRAME = 0.05
# Shortest side of a view as a share of the longest, so that there is room for its ticks.
_LEAST_SIDE = 0.35
# Size of a dot [points] times the square root of their number.
_DOTS = 60.0


class _Layer(NamedTuple):
    """Contacts that are drawn alike."""

    rows: Bool[np.ndarray, "n"]
    marker: str
    colour: str
    alpha: float
    order: float
    label: str


@checked
def contacts_figure(found: Reconstruction, *, trusted_deviation: float = 0.05) -> list[Axes]:
    """Contacts from above (xy), from the side (zy) and from the front (xz), at one scale, with 95 %
    ellipses of some of them if the noise is known.

    Rows whose status is not OK are crosses. The frame holds all trusted contacts and nine tenths of
    the others; the title says how many lie outside.

    Parameters
    ----------
    found
        Any reconstruction.
    trusted_deviation
        Contacts whose largest standard deviation exceeds this many rod lengths are drawn faintly,
        and so are their ellipses: near first contact they may lie anywhere.

    Returns
    -------
    list of Axes
        The views xy, zy and xz.

    Raises
    ------
    ValueError
        If there is no contact.
    """
    rod, factor = found.rod, length_factor(found.rod)
    points, path = (
        factor * place.reshape(-1, 3) for place in (found.point, found.reactions.trail.position)
    )
    status = found.status.ravel()
    drawn = found.in_contact.ravel() & np.isfinite(points).all(axis=1)
    if not drawn.any():
        raise no_contact(status, "samples")
    sound = drawn & (status == Status.OK)
    trusted, ellipses = sound, [np.zeros(0, dtype=int)] * 2
    covariance = np.zeros((len(points), 3, 3))
    wide = factor * trusted_deviation * rod.length
    if found.covariance is not None:
        covariance = factor**2 * found.covariance.reshape(-1, 3, 3)
        known = sound & np.isfinite(covariance).all(axis=(1, 2))
        trusted = known.copy()
        trusted[known] = np.linalg.eigvalsh(covariance[known])[:, -1] <= wide**2
        ellipses = [_some(trusted, _ELLIPSES), _some(known & ~trusted, _WIDE_ELLIPSES)]
    reach = _TWO_DIMENSIONS_95 * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    ends = [points[ellipses[0]] + sign * reach[ellipses[0]] for sign in (-1, 1)]
    frame = _frame(points, drawn, trusted, np.concatenate(ends), path, factor * rod.length)
    # Of a larger one only an arc would be seen, which could belong to any contact.
    fits = np.all(reach < np.ptp(frame, axis=0) / 2, axis=1)
    ellipses[1] = ellipses[1][fits[ellipses[1]]]
    figure, panels = _views(frame, [length_label(name, rod) for name in "xyz"])
    size = float(np.clip(_DOTS / np.sqrt(drawn.sum()), 2.4, 6.0))
    layers = _layers(found, drawn, sound, trusted, f"{wide:.3g} {_unit(found)}")
    for axes, view in zip(panels, _VIEWS, strict=True):
        for layer in layers:
            _draw(axes, layer, points[:, view], size)
        for chosen, alpha in zip(ellipses, (0.9, _FAINT), strict=True):
            if len(chosen):
                spread = covariance[chosen][:, view][:, :, view]
                _ellipses(axes, points[chosen][:, view], spread, alpha)
    outside = drawn & ~np.all((points >= frame[0]) & (points <= frame[1]), axis=1)
    title = f"{outside.sum()} of {drawn.sum()} contacts lie outside" if outside.any() else None
    handles, labels = panels[0].get_legend_handles_labels()
    shown = sum(map(len, ellipses))
    if shown:
        handles.append(_ellipse_handle(size))
        labels.append(f"95 % ellipse{'s' * (shown > 1)} of {shown} contact{'s' * (shown > 1)}")
    figure.legend(
        handles, labels, loc="outside upper center", ncols=2, markerscale=8 / size, title=title,
        title_fontsize=9, handletextpad=0.3, columnspacing=1.0,
    )  # fmt: skip
    return panels


def _unit(found: Reconstruction) -> str:
    return "mm" if found.rod.units == "SI" else "L"


def _some(rows: Bool[np.ndarray, "n"], count: int) -> np.ndarray:
    """Rows spread evenly among those chosen."""
    chosen = np.flatnonzero(rows)
    picked = np.linspace(0, len(chosen) - 1, min(count, len(chosen))).round().astype(int)
    return chosen[picked]


def _layers(
    found: Reconstruction,
    drawn: Bool[np.ndarray, "n"],
    sound: Bool[np.ndarray, "n"],
    trusted: Bool[np.ndarray, "n"],
    wide: str,
) -> list[_Layer]:
    """What is drawn alike, each with its count in its label; empty ones left out."""
    kind, layers = found.kind.ravel(), []
    for code, colour in KIND_COLOURS.items():
        name, own = KIND_NAMES[code], kind == code
        rows, doubtful = own & trusted, own & sound & ~trusted
        layers.append(_Layer(rows, ".", colour, 1.0, 2.5, f"{name} ({rows.sum()})"))
        label = f"{name}, σ above {wide} ({doubtful.sum()})"
        layers.append(_Layer(doubtful, ".", colour, _FAINT, 1.5, label))
    flagged = drawn & ~sound
    if flagged.any():
        label = status_words(found.status.ravel()[flagged])
        layers.append(_Layer(flagged, "x", _FLAGGED_COLOUR, 0.7, 2, label))
    return [layer for layer in layers if layer.rows.any()]


def _frame(
    points: Float[np.ndarray, "n 3"],
    drawn: Bool[np.ndarray, "n"],
    trusted: Bool[np.ndarray, "n"],
    ends: Float[np.ndarray, "m 3"],
    path: Float[np.ndarray, "n 3"],
    reach: float,
) -> Float[np.ndarray, "2 3"]:
    """Least and largest coordinates to show: of contacts within the rod's reach from its clamp, and
    `ends` of ellipses.
    """
    others = points[drawn & ~trusted]
    tails = np.percentile(others, [_TAIL, 100 - _TAIL], axis=0) if len(others) else others
    every = np.concatenate([points[trusted], tails])
    low = np.maximum(every.min(axis=0), path.min(axis=0) - reach)
    high = np.minimum(every.max(axis=0), path.max(axis=0) + reach)
    low = np.concatenate([[low], ends]).min(axis=0)
    high = np.concatenate([[high], ends]).max(axis=0)
    longest = max(np.max(high - low), _LEAST_FRAME * reach)
    half = np.maximum((high - low) / 2, _LEAST_SIDE / 2 * longest) + _MARGIN * longest
    return (low + high) / 2 + np.array([[-1.0], [1.0]]) * half


def _views(frame: Float[np.ndarray, "2 3"], names: list[str]) -> tuple[Figure, list[Axes]]:
    """Three panels at one scale as in a technical drawing: xy with zy beside it and xz below."""
    across, up, deep = frame[1] - frame[0]
    inch = min((PAGE - 1.2) / (across + deep), 3.6 / (up + deep))
    figure, grid = plt.subplots(
        2,
        2,
        figsize=(inch * (across + deep) + 1.2, inch * (up + deep) + 1.6),
        width_ratios=(across, deep),
        height_ratios=(up, deep),
        layout="compressed",
    )
    grid[1, 1].remove()
    panels = [grid[0, 0], grid[0, 1], grid[1, 0]]
    for axes, view in zip(panels, _VIEWS, strict=True):
        axes.set(xlim=frame[:, view[0]], ylim=frame[:, view[1]])
        axes.set(xlabel=names[view[0]], ylabel=names[view[1]])
        axes.set_aspect("equal", adjustable="box")
        for axis, length in zip((axes.xaxis, axes.yaxis), np.ptp(frame, axis=0)[view], strict=True):
            axis.set_major_locator(MaxNLocator(nbins=max(2, int(2.2 * inch * length))))
    return figure, panels


def _draw(axes: Axes, layer: _Layer, places: Float[np.ndarray, "n 2"], size: float) -> None:
    axes.plot(
        *places[layer.rows].T,
        layer.marker,
        color=layer.colour,
        alpha=layer.alpha,
        markersize=size,
        markeredgewidth=0.4 if layer.marker == "x" else 0,
        label=layer.label,
        zorder=layer.order,
    )


def _ellipses(
    axes: Axes,
    centers: Float[np.ndarray, "k 2"],
    covariance: Float[np.ndarray, "k 2 2"],
    alpha: float,
) -> None:
    variances, directions = np.linalg.eigh(covariance)
    widths = 2 * _TWO_DIMENSIONS_95 * np.sqrt(np.maximum(variances, 0))
    ellipses = EllipseCollection(
        widths[:, 1],
        widths[:, 0],
        np.degrees(np.arctan2(directions[:, 1, 1], directions[:, 0, 1])),
        units="xy",
        offsets=centers,
        offset_transform=axes.transData,
        facecolor="none",
        edgecolor=_ELLIPSE_COLOUR,
        linewidth=0.6,
        alpha=alpha,
        zorder=3,
    )
    axes.add_collection(ellipses, autolim=False)


def _ellipse_handle(size: float) -> Line2D:
    return Line2D(
        [],
        [],
        linestyle="none",
        marker="o",
        markersize=size,
        markerfacecolor="none",
        markeredgecolor=_ELLIPSE_COLOUR,
        markeredgewidth=0.6,
    )
