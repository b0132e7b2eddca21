"""What a calibration left unexplained, and which parameters its data cannot tell apart."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.stats import norm

from vibrissa.calibration import Calibration, Residuals
from vibrissa.plot.arguments import checked
from vibrissa.plot.style import COLUMN, PAGE
from vibrissa.sensor.deviations import deviation_by_differences

_CHANNELS = ("$f_x$", "$f_y$", "$f_z$", "$m_x$", "$m_y$", "$m_z$")
# Told apart by colour-blind readers too (Okabe and Ito).
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#444444")
_MEANS = 40
_LIMIT = 5.0
# In median steps: where a step is longer, rows were left out.
_GAP = 2.0
# Parameters up to which the correlations are written out.
_MOST_NUMBERS = 16


@checked
def residuals_over_time(calibration: Calibration[Any]) -> list[Axes]:
    """Residuals of the six channels [standard deviations of a row] over time, with their running
    mean: white noise about zero if the model is right.
    """
    residuals = calibration.residuals
    rows, left = _deviations(residuals)
    time, recording = residuals.time[rows], residuals.recording[rows]
    figure, grid = plt.subplots(
        3, 2, figsize=(PAGE, 4.4), sharex=True, sharey=True, layout="constrained"
    )
    panels = list(grid.T.flat)
    for axes, values, name in zip(panels, left.T, _CHANNELS, strict=True):
        for number in np.unique(recording).tolist():
            own, colour = recording == number, _COLOURS[number % len(_COLOURS)]
            x, y = time[own], values[own]
            axes.plot(x, y, ".", color=colour, markersize=2.5, alpha=0.5, markeredgewidth=0)
            means = _means(x, y)
            # The line ends where rows were left out.
            steps = np.diff(means[0], prepend=means[0][:1])
            gaps = np.flatnonzero(steps > _GAP * np.median(steps))
            label = f"running mean, recording {number + 1}"
            axes.plot(*np.insert(means, gaps, np.nan, axis=1), color=colour, label=label)
        axes.axhline(0.0, color="0.4", linewidth=0.5)
        axes.set(ylabel=f"{name} [$\\sigma$]", ylim=(-_LIMIT, _LIMIT))
    plt.setp(grid[-1], xlabel="time [s]")
    _legend(figure, panels, left)
    return panels


@checked
def residual_histogram(calibration: Calibration[Any]) -> Axes:
    """Whitened residuals of all channels in contact, against the normal distribution."""
    residuals = calibration.residuals
    values = residuals.whitened[residuals.contact & (residuals.weight > 0)].ravel()
    figure, axes = plt.subplots(figsize=(COLUMN * 1.2, COLUMN * 0.9), layout="constrained")
    grid = np.linspace(-_LIMIT, _LIMIT, 61)
    values, bins = np.clip(values, -_LIMIT, _LIMIT), grid.tolist()
    axes.hist(values, bins=bins, density=True, color="#9ecae1", label="residuals")
    axes.plot(grid, norm.pdf(grid), color="black", label="normal distribution")
    axes.set(yscale="log", ylim=(1e-5, 1.0))
    axes.set(xlabel=r"residual [$\sigma$]", ylabel=r"density [1/$\sigma$]")
    figure.legend(loc="outside upper center", ncols=2)
    return axes


@checked
def residuals_over_force(calibration: Calibration[Any]) -> list[Axes]:
    """Residuals of the six channels [standard deviations of a row] over the contact force, with
    their running mean: a slope hints at a wrong gain or stiffness.
    """
    residuals = calibration.residuals
    rows, left = _deviations(residuals)
    force = np.linalg.norm(residuals.reading[rows, :3], axis=1)
    order = np.argsort(force)
    unit = "N" if calibration.setup.rod.units == "SI" else "$EI/L^2$"
    figure, panels = plt.subplots(
        2, 3, figsize=(PAGE, 3.6), sharex=True, sharey=True, layout="constrained"
    )
    for axes, values, name in zip(panels.flat, left.T, _CHANNELS, strict=True):
        axes.plot(force, values, ".", color="0.6", markersize=2.5, markeredgewidth=0)
        means = _means(force[order], values[order])
        axes.plot(*means, color=_COLOURS[1], label="running mean")
        axes.axhline(0.0, color="0.4", linewidth=0.5)
        axes.set(title=name, ylim=(-_LIMIT, _LIMIT))
    plt.setp(panels[-1], xlabel=f"contact force [{unit}]")
    plt.setp(panels[:, 0], ylabel=r"residual [$\sigma$]")
    _legend(figure, list(panels.flat), left)
    return list(panels.flat)


@checked
def parameter_correlation(calibration: Calibration[Any]) -> Axes:
    """Correlation of the estimates' errors: near 1 or −1 two parameters are hard to tell apart."""
    known = calibration.identifiability
    names = [name.replace("_", " ").replace("youngs", "Young's") for name in known.names]
    size = max(COLUMN * 1.1, 0.42 * len(names) + 1.6)
    figure, axes = plt.subplots(figsize=(size * 1.15, size), layout="constrained")
    image = axes.imshow(known.correlation, cmap="RdBu_r", vmin=-1, vmax=1)
    axes.set_xticks(range(len(names)), names, rotation=45, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(names)), names)
    if len(names) <= _MOST_NUMBERS:
        for (row, column), value in np.ndenumerate(known.correlation):
            number, colour = f"{value:.2f}".replace("-", "−"), "w" if abs(value) > 0.6 else "k"
            axes.text(column, row, number, ha="center", va="center", fontsize=8, color=colour)
    figure.colorbar(image, ax=axes, label="correlation", shrink=0.8)
    return axes


def _legend(figure: Figure, panels: list[Axes], left: Float[np.ndarray, "rows 6"]) -> None:
    """What dots and lines are, and how many dots lie outside."""
    handles, _ = panels[0].get_legend_handles_labels()
    handles.insert(0, Line2D([], [], linestyle="none", marker=".", color="0.5", label="one row"))
    outside = int((np.abs(left) > _LIMIT).sum())
    title = f"{outside} of {left.size} residuals lie outside" if outside else None
    figure.legend(handles=handles, loc="outside upper center", ncols=4, title=title)


def _deviations(
    residuals: Residuals,
) -> tuple[Bool[np.ndarray, "rows"], Float[np.ndarray, "shown 6"]]:
    """The rows to show, and their reading minus prediction in standard deviations of each channel's
    scatter about its running mean.
    """
    rows = residuals.contact & (residuals.weight > 0)
    left = (residuals.reading - residuals.predicted)[rows]
    # Differences of neighbours contain only noise, whatever the model leaves, and their median is
    # free of outliers.
    return rows, left / deviation_by_differences(np.diff(left, axis=0), 1)


def _means(x: Float[np.ndarray, "n"], values: Float[np.ndarray, "n"]) -> Float[np.ndarray, "2 k"]:
    """Means over groups of neighbours."""
    parts = min(_MEANS, max(1, len(x) // 5))
    split = np.array_split(np.stack([x, values]), parts, axis=1)
    return np.stack([part.mean(axis=1) for part in split], axis=1)
