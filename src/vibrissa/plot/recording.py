"""A recording with its tare, faults, noise and pose."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter
from scipy.signal import welch

from vibrissa.geometry.rotation import rotation_vectors
from vibrissa.plot.style import PAGE
from vibrissa.sensor import CHANNELS, FaultKind, Inspection, Sensor

_AXIS_COLOURS = ("#c1121f", "#2b7a3d", "#1d5fa8")
_TARE_COLOUR = "#bcd9ea"
_FAULT_COLOURS = {
    FaultKind.SATURATION: "#e07b00",
    FaultKind.DROP_OUT: "#7a3e9d",
    FaultKind.STUCK: "#8c6d31",
    FaultKind.HELD: "#c77cba",
    FaultKind.GAP: "#555555",
    FaultKind.DUPLICATE: "#d0a000",
    FaultKind.BACKWARD: "#a00000",
    FaultKind.POSE_JUMP: "#00808a",
}
# Name, symbols, factor and unit of the readings, and of their noise.
_KINDS = (
    ("force", ("f_x", "f_y", "f_z"), 1.0, "N", 1e3, r"mN/$\sqrt{\mathrm{Hz}}$"),
    ("torque", (r"\tau_x", r"\tau_y", r"\tau_z"), 1e3, "N mm", 1e6, r"µN m/$\sqrt{\mathrm{Hz}}$"),
)
_LONGEST_SEGMENT = 4096  # of a spectrum: resolves half a hertz at 2 kHz
_FEWEST = 32  # samples of a segment: a density over a decade and more
_LARGEST = 1e12  # beyond are marks of loggers for missing numbers
# Half a decade to either side at least: noise that follows its density looks flat.
_LEAST_SPAN = 10**0.5
# Beyond so much between least and largest, decades alone are labelled.
_FEW_DECADES = 1e3


def recording_figure(found: Inspection, sensor: Sensor) -> list[Axes]:
    """Force and torque over time as logged, with tare intervals and faults shaded; the sensor's
    pose; and the noise's amplitude spectral density at rest.

    Parameters
    ----------
    found
        Of `vibrissa.sensor.inspect_raw`; lines of rows that are not usable are faint.
    sensor
        For the stated noise.
    """
    figure = plt.figure(figsize=(PAGE, 6.6), layout="constrained")
    grid = figure.add_gridspec(4, 2, height_ratios=(1.25, 1.25, 1, 1.25))
    force = figure.add_subplot(grid[0, :])
    torque, pose = (figure.add_subplot(grid[row, :], sharex=force) for row in (1, 2))
    spectra = [figure.add_subplot(grid[3, column]) for column in (0, 1)]
    time = found.cleaned.time - found.cleaned.time[0]
    logged = np.where(np.abs(found.raw.wrench) < _LARGEST, found.raw.wrench, np.nan)
    for axes, (name, symbols, factor, unit, *_), first in zip(
        (force, torque), _KINDS, (0, 3), strict=True
    ):
        for channel, (symbol, colour) in enumerate(zip(symbols, _AXIS_COLOURS, strict=True), first):
            faint, clear = logged[:, channel], found.cleaned.wrench[:, channel]
            axes.plot(time, factor * faint, color=colour, linewidth=0.7, alpha=0.35)
            axes.plot(time, factor * clear, color=colour, linewidth=0.7, label=f"${symbol}$")
        axes.set_ylabel(f"{name} [{unit}]")
        axes.tick_params(labelbottom=False)
        _shade(axes, found, CHANNELS[first : first + 3], 1.005)
    _pose(pose, found)
    for axes, first in zip(spectra, (0, 3), strict=True):
        _spectrum(axes, found, sensor, first)
    kinds = {fault.kind for fault in found.faults}
    handles = [
        Patch(color=colour, alpha=0.45, label=str(kind))
        for kind, colour in _FAULT_COLOURS.items()
        if kind in kinds
    ]
    if found.tare is not None and found.tare.intervals:
        handles.insert(0, Patch(color=_TARE_COLOUR, label="tare"))
    if handles:
        columns = min(6, len(handles))
        figure.legend(handles=handles, loc="outside upper center", ncols=columns, handlelength=1.2)
    return [force, torque, pose, *spectra]


def _shade(axes: Axes, found: Inspection, names: tuple[str, ...], right: float) -> None:
    """Tare and faults of these channels behind the lines, and the legend at this place."""
    first, last = found.cleaned.time[[0, -1]]
    spans = [
        (start, stop, {"color": _TARE_COLOUR, "alpha": 0.6, "zorder": 0.0})
        for start, stop in (found.tare.intervals if found.tare is not None else ())
    ]
    for fault in found.faults:
        if fault.kind in _FAULT_COLOURS and set(names) & set(fault.channels):
            middle, wide = (fault.start + fault.stop) / 2, abs(fault.stop - fault.start)
            half = max(wide / 2, 0.002 * (last - first))
            # What fills the figure must not hide it.
            alpha = 0.45 if half < (last - first) / 4 else 0.15
            style = {"color": _FAULT_COLOURS[fault.kind], "alpha": alpha, "zorder": 0.5}
            spans.append((middle - half, middle + half, style))
    for start, stop, style in spans:
        axes.axvspan(start - first, stop - first, linewidth=0, **style)
    axes.legend(loc="upper left", bbox_to_anchor=(right, 1.0), handlelength=1.2, borderaxespad=0)


def _pose(axes: Axes, found: Inspection) -> None:
    raw = found.cleaned
    time, moved = raw.time - raw.time[0], 1e3 * (raw.position - raw.position[0])
    for axis, part, colour in zip("xyz", moved.T, _AXIS_COLOURS, strict=True):
        axes.plot(time, part, color=colour, linewidth=0.8, label=f"${axis}$")
    axes.set(ylabel="moved [mm]", xlabel="time since the first stamp [s]", xlim=time[[0, -1]])
    start = np.broadcast_to(raw.orientation[0], raw.orientation.shape)
    turned = np.degrees(np.linalg.norm(rotation_vectors(start, raw.orientation), axis=1))
    turns = turned.max() > 0.01
    if turns:
        twin = axes.twinx()
        twin.plot(time, turned, color="0.35", linewidth=0.8, linestyle="--", label="turned")
        twin.set_ylabel("turned [°]")
    _shade(axes, found, ("position", "orientation", "time"), 1.075 if turns else 1.005)


def _spectrum(axes: Axes, found: Inspection, sensor: Sensor, first: int) -> None:
    """Welch's estimate over the longest rest, against the density of the stated noise and rounding,
    with its pink part.
    """
    name, *_, factor, unit = _KINDS[first // 3]
    axes.set(xlabel="frequency [Hz]", ylabel=f"{name} [{unit}]", title="noise at rest")
    tared = found.tare.intervals if found.tare is not None else ()
    intervals = [found.cleaned.during(interval) for interval in tared or found.rest.intervals]
    rows = max(intervals, key=np.count_nonzero, default=np.zeros(len(found.usable), dtype=bool))
    wrench = found.cleaned.wrench[rows & found.usable, first : first + 3]
    if len(wrench) < _FEWEST:
        axes.text(0.5, 0.5, "no rest", transform=axes.transAxes, ha="center", va="center")
        axes.set(xticks=[], yticks=[])
        return
    segment = min(_LONGEST_SEGMENT, max(_FEWEST, len(wrench) // 4))
    frequency, density = welch(wrench.T, fs=found.rate, nperseg=segment, detrend="linear")
    for part, colour in zip(factor * np.sqrt(density), _AXIS_COLOURS, strict=True):
        axes.loglog(frequency[1:-1], part[1:-1], color=colour, linewidth=0.8)
    if sensor.noise.known:
        white, own = (
            part[first : first + 3] * 2 / found.rate
            for part in (sensor.noise.variance, sensor.noise.white**2)
        )
        stated = factor * np.sqrt(white + own * sensor.noise_corner / frequency[1:, None])
        for part in np.unique(stated, axis=1).T:
            axes.loglog(frequency[1:], part, "k--", linewidth=0.9, label="stated")
        axes.legend(handles=[axes.lines[-1]], loc="best")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        labelled = (1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,)
        axis.set_major_locator(LogLocator(subs=labelled, numticks=8))
        axis.set_major_formatter(FormatStrFormatter("%g"))
        axis.set_minor_formatter(NullFormatter())
    low, high = axes.get_ylim()
    middle = np.sqrt(low * high)
    axes.set_ylim(min(low, middle / _LEAST_SPAN), max(high, middle * _LEAST_SPAN))
