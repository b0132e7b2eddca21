"""Support reactions over the clamp plane (paper, figure 2)."""

from textwrap import fill

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from vibrissa.contacts import Status
from vibrissa.drawing import length_factor
from vibrissa.forward import Scan
from vibrissa.plot.arguments import checked
from vibrissa.plot.style import PAGE, length_label, no_contact, status_words
from vibrissa.rod import Rod

# Symbols, SI units with their factors, and the model's units.
_PANELS = [(f"f_{{0{axis}}}", "N", 1.0, "$EI/L^2$") for axis in "xyz"]
_PANELS += [(f"m_{{0{axis}}}", "N mm", 1e3, "$EI/L$") for axis in "xyz"]
# Of the largest component of its kind: what is smaller is rounding.
_ZERO = 1e-8
# Least width of a panel as a share of its height, and the other way round.
_LEAST_ASPECT = 0.3
_MARGIN = 0.05
_PATH, _LEFT_OUT, _FLAGGED = "0.75", "0.35", "black"
# In rod lengths: a clamp that moves less stands.
_STILL = 1e-9
# Left-out trails up to which each is named.
_MOST_NAMES = 3
# Letters in a line of the legend.
_WIDTH = 24


@checked
def reactions_over_plane(scan: Scan, *, skip: tuple[int, ...] = ()) -> list[Axes]:
    """Each support reaction, coloured along the trails over the clamp points, in the two world axes
    along which the clamps extend farthest.

    A component that is zero everywhere has no panel; the figure says so. Rows whose status is not
    OK have a black line along them, and do not decide the colour scale unless there are no others.

    Parameters
    ----------
    scan
        Scan of several trails (m, n, …).
    skip
        Trails whose reactions are left out: dotted, and named in the legend.

    Raises
    ------
    ValueError
        If the scan has only one trail, `skip` names one that there is not or leaves none, the
        clamp does not move on those shown, or there is no contact on them.
    """
    rod, shown = scan.rod, _shown(scan, skip)
    values = scan.reactions.wrench[shown]
    contact = scan.in_contact[shown] & np.isfinite(values).all(axis=-1)
    if not contact.any():
        raise no_contact(scan.status[shown], "positions")
    sound = contact & (scan.status[shown] == Status.OK)
    clamp = length_factor(rod) * scan.trail.position
    across = sorted(np.argsort(-np.ptp(clamp, axis=(0, 1)), kind="stable")[:2].tolist())
    clamp = clamp[..., across]
    sizes = np.abs(values[sound if sound.any() else contact]).max(axis=0)
    largest = np.repeat(sizes.reshape(2, 3).max(axis=1), 3)
    kept = sizes > _ZERO * largest
    limits = _limits(clamp.reshape(-1, 2))
    figure, grid = _grid(limits)
    stretches = _stretches(clamp[shown])
    for number, axes in enumerate(grid.flat):
        if not kept[number]:
            axes.set_axis_off()
            continue
        symbol, unit, factor, own = _PANELS[number]
        factor, unit = (factor, unit) if rod.units == "SI" else (1.0, own)
        axes.set(title=f"${symbol}$ [{unit}]", xlim=limits[:, 0], ylim=limits[:, 1])
        axes.set_aspect("equal", adjustable="box")
        paths = np.moveaxis(clamp[shown], -1, 0).swapaxes(1, 2)
        axes.plot(*paths, color=_PATH, linewidth=0.5, zorder=0.5)
        axes.plot(*np.moveaxis(clamp[list(skip)], -1, 0).swapaxes(1, 2), ":", color=_LEFT_OUT)
        _colour(axes, stretches, factor * values[..., number], contact, factor * sizes[number])
        flagged = stretches[contact & ~sound]
        axes.add_collection(LineCollection(list(flagged), colors=_FLAGGED, linewidths=0.9))
    _label_edges(grid, kept.reshape(2, 3), [length_label(f"{'xyz'[i]}_0", rod) for i in across])
    handles = [Line2D([], [], color=_PATH, linewidth=0.8, label="no contact")]
    if (contact & ~sound).any():
        words = fill(status_words(scan.status[shown][contact & ~sound]), _WIDTH)
        handles.append(Line2D([], [], color=_FLAGGED, linewidth=0.9, label=words))
    if skip:
        words = _names(clamp[list(skip)], "xyz"[across[1]], rod)
        handles.append(Line2D([], [], color=_LEFT_OUT, linestyle=":", label=words))
    _legend(figure, grid, kept, handles)
    return [axes for axes, keep in zip(grid.flat, kept, strict=True) if keep]


def _shown(scan: Scan, skip: tuple[int, ...]) -> Int[np.ndarray, "shown"]:
    """Trails that are not left out, as far as there is something to draw of them."""
    if scan.kind.ndim != 2:
        raise ValueError(f"scan has the shape {scan.kind.shape}; allowed are several trails (m, n)")
    trails = len(scan.kind)
    shown = np.setdiff1d(np.arange(trails), skip)
    if not set(skip) <= set(range(trails)) or not len(shown):
        raise ValueError(
            f"skip = {skip}; allowed are numbers from 0 to {trails - 1}, not all of the {trails} "
            "trails"
        )
    moved = np.ptp(scan.trail.position[shown], axis=1).max()
    if scan.trail.count > 1 and moved < _STILL * scan.rod.length:
        raise ValueError(
            "nothing to draw: the clamp turns about one point on each trail; allowed are clamps "
            "that move, or `reactions_along` for one trail"
        )
    return shown


def _limits(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2 2"]:
    """Least and largest coordinates to show, neither side too short for its ticks."""
    low, high = points.min(axis=0), points.max(axis=0)
    # The outermost trails are as wide as all others.
    half = 0.5 * (high - low) + _MARGIN * (high - low).max()
    half = np.maximum(half, _LEAST_ASPECT * half.max())
    half = np.where(half > 0, half, 1.0)
    middle = (low + high) / 2
    limits: Float[np.ndarray, "2 2"] = np.stack([middle - half, middle + half])
    return limits


def _grid(limits: Float[np.ndarray, "2 2"]) -> tuple[Figure, np.ndarray]:
    """Two rows of three panels, as high as they need to be."""
    wide, high = limits[1] - limits[0]
    each = min(1.35 * high / wide, 2.2)
    return plt.subplots(
        2, 3, figsize=(PAGE, 2 * each + 1.9), sharex=True, sharey=True, layout="compressed"
    )


def _stretches(clamp: Float[np.ndarray, "m n 2"]) -> Float[np.ndarray, "m n 2 2"]:
    """What each position stands for: from half-way to its predecessor to half-way to the next."""
    middle = (clamp[:, :-1] + clamp[:, 1:]) / 2
    start = np.concatenate([clamp[:, :1], middle], axis=1)
    stop = np.concatenate([middle, clamp[:, -1:]], axis=1)
    return np.stack([start, stop], axis=2)


def _colour(
    axes: Axes,
    stretches: Float[np.ndarray, "m n 2 2"],
    values: Float[np.ndarray, "m n"],
    rows: Bool[np.ndarray, "m n"],
    largest: float,
) -> None:
    """Stretches coloured by their values, white at zero, with a colour bar to ±`largest`."""
    line = LineCollection(
        list(stretches[rows]),
        array=values[rows],
        cmap="RdBu_r",
        norm=Normalize(-largest, largest),
        linewidth=5,
        # Smoothed edges would show as seams between neighbours.
        antialiased=False,
        rasterized=True,
        capstyle="butt" if stretches.shape[1] > 1 else "projecting",
    )
    axes.add_collection(line)
    # Rounding must not decide whether there is more than the bar shows.
    over = values[rows].max() > 1.001 * largest
    under = values[rows].min() < -1.001 * largest
    extend = {(0, 0): "neither", (1, 0): "max", (0, 1): "min", (1, 1): "both"}[
        int(over), int(under)
    ]
    figure = axes.get_figure(root=True)
    assert figure is not None
    # As high as the panel, and about as wide whatever the panel's shape.
    width = 0.05 * max(1.0, float(np.divide(*np.ptp([axes.get_ylim(), axes.get_xlim()], axis=1))))
    bar = figure.colorbar(line, cax=axes.inset_axes((1.04, 0, width, 1)), extend=extend)
    bar.locator = MaxNLocator(nbins=4, symmetric=True)
    bar.update_ticks()
    bar.outline.set_linewidth(0.5)


def _label_edges(grid: np.ndarray, kept: Bool[np.ndarray, "2 3"], labels: list[str]) -> None:
    """Label the lowest panel of each column and the first of each row."""
    for (row, column), axes in np.ndenumerate(grid):
        if not kept[row, column]:
            continue
        axes.xaxis.set_major_locator(MaxNLocator(nbins=4))
        axes.yaxis.set_major_locator(MaxNLocator(nbins=4))
        lowest, first = not kept[row + 1 :, column].any(), not kept[row, :column].any()
        axes.tick_params(labelbottom=lowest, labelleft=first)
        if lowest:
            axes.set_xlabel(labels[0])
        if first:
            axes.set_ylabel(labels[1])


def _legend(
    figure: Figure, grid: np.ndarray, kept: Bool[np.ndarray, "6"], handles: list[Line2D]
) -> None:
    """In place of the last component that is zero, if there is one; says which are."""
    if kept.all():
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
        return
    zero = np.flatnonzero(~kept)
    title = " = ".join(f"${_PANELS[number][0]}$" for number in zero) + " = 0 throughout"
    grid.flat[zero[-1]].legend(
        handles=handles, loc="center", title=title, title_fontsize=9, handlelength=1.6
    )


def _names(clamp: Float[np.ndarray, "k n 2"], axis: str, rod: Rod) -> str:
    """Left-out trails by the coordinate they keep, or their count."""
    places = clamp[:, 0, 1]
    if len(clamp) > _MOST_NAMES or np.ptp(clamp[..., 1], axis=1).max() > 0:
        return f"{len(clamp)} trails left out"
    # Without a negative zero.
    numbers = ", ".join(f"{place + 0.0:.3g}" for place in places)
    unit = " mm" if rod.units == "SI" else ""
    symbol = f"{axis}_0" if rod.units == "SI" else f"{axis}_0/L"
    return f"left out: ${symbol}$ = {numbers}{unit}"
