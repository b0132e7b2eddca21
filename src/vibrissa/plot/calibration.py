"""What a calibration left unexplained, and which parameters its data confuse."""

from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from scipy.stats import norm

from vibrissa.calibration import Calibration, Residuals
from vibrissa.plot.style import COLUMN, PAGE

_CHANNELS = ("$f_x$", "$f_y$", "$f_z$", "$m_x$", "$m_y$", "$m_z$")
_COLOURS = ("#1d5fa8", "#c1121f", "#2a7f3f", "#8a5a00", "#6a3d9a", "#444444")
_DOT, _LINE = "0.75", "#c1121f"
_MEANS = 40
_LIMIT = 5.0
_GAP = 2.0


def residuals_over_time(calibration: Calibration[Any]) -> list[Axes]:
    """Residuals of the six channels [standard deviations of a row] over time, with their running
    mean: white noise about zero where the model is right.
    """
    residuals = calibration.residuals
    left = _deviations(residuals)
    figure, panels = plt.subplots(
        6, 1, figsize=(PAGE, 6.6), sharex=True, sharey=True, layout="constrained"
    )
    for recording in np.unique(residuals.recording):
        rows = residuals.contact & (residuals.recording == recording) & (residuals.weight > 0)
        colour = _COLOURS[int(recording) % len(_COLOURS)]
        for axes, values in zip(panels, left[rows].T, strict=True):
            axes.plot(
                residuals.time[rows],
                values,
                ".",
                color=colour,
                markersize=1.6,
                alpha=0.45,
                markeredgewidth=0,
            )
            axes.plot(
                *_broken(*_means(residuals.time[rows], values)),
                color=colour,
                label=f"recording {int(recording) + 1}",
            )
    for axes, name in zip(panels, _CHANNELS, strict=True):
        axes.axhline(0.0, color="0.4", linewidth=0.5)
        axes.set_ylabel(f"{name} [$\\sigma$]")
    panels[0].set_ylim(-_LIMIT, _LIMIT)
    panels[-1].set_xlabel("time [s]")
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=4)
    return list(panels)


def residual_histogram(calibration: Calibration[Any]) -> Axes:
    """Residuals of all channels in contact, made independent of each other, against the normal
    distribution.
    """
    residuals = calibration.residuals
    values = residuals.whitened[residuals.contact & (residuals.weight > 0)].ravel()
    _, axes = plt.subplots(figsize=(COLUMN * 1.2, COLUMN * 0.9), layout="constrained")
    bins = np.linspace(-_LIMIT, _LIMIT, 61)
    axes.hist(
        np.clip(values, -_LIMIT, _LIMIT),
        bins=bins.tolist(),
        density=True,
        color="#9ecae1",
        label="residuals",
    )
    grid = np.linspace(-_LIMIT, _LIMIT, 401)
    axes.plot(grid, norm.pdf(grid), color="black", label="normal distribution")
    axes.set_yscale("log")
    axes.set_ylim(1e-5, 1.0)
    axes.set_xlabel(r"residual [$\sigma$]")
    axes.set_ylabel(r"density [1/$\sigma$]")
    axes.legend(loc="upper right")
    return axes


def residuals_over_force(calibration: Calibration[Any]) -> list[Axes]:
    """Residuals of the six channels [standard deviations of a row] over the contact force, with
    their running mean: a slope hints at gain or stiffness.
    """
    residuals = calibration.residuals
    rows = residuals.contact & (residuals.weight > 0)
    force, left = np.linalg.norm(residuals.reading[rows, :3], axis=1), _deviations(residuals)[rows]
    order = np.argsort(force)
    unit = "N" if calibration.setup.rod.units == "SI" else "EI/L^2"
    _, panels = plt.subplots(
        2, 3, figsize=(PAGE, 3.6), sharex=True, sharey=True, layout="constrained"
    )
    for axes, values, name in zip(panels.ravel(), left.T, _CHANNELS, strict=True):
        axes.plot(force, values, ".", color=_DOT, markersize=1.5, markeredgewidth=0)
        axes.plot(*_means(force[order], values[order]), color=_LINE)
        axes.axhline(0.0, color="0.4", linewidth=0.5)
        axes.set_title(name)
        axes.set_ylim(-_LIMIT, _LIMIT)
    for axes in panels[-1]:
        axes.set_xlabel(f"contact force [{unit}]" if unit == "N" else f"contact force [${unit}$]")
    for axes in panels[:, 0]:
        axes.set_ylabel(r"residual [$\sigma$]")
    return list(panels.ravel())


def parameter_correlation(calibration: Calibration[Any]) -> Axes:
    """Correlation of the estimates' errors: towards 1 or −1 two parameters are hardly told apart."""
    known = calibration.identifiability
    names = [name.replace("_", " ") for name in known.names]
    size = max(COLUMN * 1.1, 0.36 * len(names) + 1.6)
    figure, axes = plt.subplots(figsize=(size * 1.15, size), layout="constrained")
    image = axes.imshow(known.correlation, cmap="RdBu_r", vmin=-1, vmax=1)
    axes.set_xticks(range(len(names)), names, rotation=45, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(names)), names)
    if len(names) <= _MOST_NUMBERS:
        for (row, column), value in np.ndenumerate(known.correlation):
            axes.text(
                column,
                row,
                f"{value:.2f}".replace("-", "−"),
                ha="center",
                va="center",
                fontsize=6,
                color="white" if abs(value) > 0.6 else "black",
            )
    figure.colorbar(image, ax=axes, label="correlation", shrink=0.8)
    return axes


_MOST_NUMBERS = 16


def _deviations(residuals: Residuals) -> np.ndarray:
    """Reading less prediction in standard deviations of each channel, as the rows in contact
    scatter about their running mean.
    """
    left = residuals.reading - residuals.predicted
    rows = residuals.contact & (residuals.weight > 0)
    # Differences of neighbours hold the noise alone, whatever the model leaves: √2 of it, by the
    # median so that outliers do not count.
    noise = np.median(np.abs(np.diff(left[rows], axis=0)), axis=0) / (0.6745 * np.sqrt(2))
    return np.asarray(left / noise)


def _broken(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The line ends where rows were left out."""
    steps = np.diff(time)
    gaps = (
        1 + np.flatnonzero(steps > _GAP * np.median(steps))
        if len(steps)
        else np.empty(0, dtype=int)
    )
    return np.insert(time, gaps, np.nan), np.insert(values, gaps, np.nan)


def _means(x: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means over groups of neighbours."""
    parts = min(_MEANS, max(1, len(x) // 5))
    return tuple(
        np.array([np.mean(part) for part in np.array_split(array, parts)]) for array in (x, values)
    )  # type: ignore[return-value]
