"""A recording with its tare, faults, noise and pose."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.gridspec import GridSpec
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
_SYMBOLS = ("f_x", "f_y", "f_z", r"\tau_x", r"\tau_y", r"\tau_z")
_LONGEST_SEGMENT = 4096
_FEWEST = 32
_LARGEST = 1e12
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
    grid = GridSpec(4, 2, figure=figure, height_ratios=(1.25, 1.25, 1, 1.25))
    force = figure.add_subplot(grid[0, :])
    torque, pose = (figure.add_subplot(grid[row, :], sharex=force) for row in (1, 2))
    spectra = [figure.add_subplot(grid[3, column]) for column in (0, 1)]
    time = found.cleaned.time - found.cleaned.time[0]
    wrench, logged = (
        found.cleaned.wrench,
        np.where(np.abs(found.raw.wrench) < _LARGEST, found.raw.wrench, np.nan),
    )
    for axes, first, factor, label in (
        (force, 0, 1.0, "force [N]"),
        (torque, 3, 1e3, "torque [N mm]"),
    ):
        for channel in range(first, first + 3):
            axes.plot(
                time,
                factor * logged[:, channel],
                color=_AXIS_COLOURS[channel - first],
                linewidth=0.7,
                alpha=0.35,
            )
            axes.plot(
                time,
                factor * wrench[:, channel],
                color=_AXIS_COLOURS[channel - first],
                linewidth=0.7,
                label=f"${_SYMBOLS[channel]}$",
            )
        axes.set_ylabel(label)
        _shade(axes, found, set(CHANNELS[first : first + 3]))
        axes.legend(
            loc="upper left", bbox_to_anchor=(1.005, 1.0), handlelength=1.2, borderaxespad=0
        )
        axes.tick_params(labelbottom=False)
    _pose(pose, found)
    for axes, first in zip(spectra, (0, 3), strict=True):
        _spectrum(axes, found, sensor, first)
    handles = _legend(found)
    if handles:
        figure.legend(
            handles=handles,
            loc="outside upper center",
            ncols=min(6, len(handles)),
            handlelength=1.2,
        )
    return [force, torque, pose, *spectra]


def _shade(axes: Axes, found: Inspection, names: set[str]) -> None:
    first = found.cleaned.time[0]
    for start, stop in found.tare.intervals if found.tare is not None else ():
        axes.axvspan(
            start - first, stop - first, color=_TARE_COLOUR, alpha=0.6, linewidth=0, zorder=0
        )
    least = 0.002 * (found.cleaned.time[-1] - first)
    for fault in found.faults:
        if fault.kind in _FAULT_COLOURS and names & set(fault.channels):
            start, stop = sorted((fault.start - first, fault.stop - first))
            middle, half = (start + stop) / 2, max(stop - start, least) / 2
            # What fills the figure must not hide it.
            alpha = 0.45 if half < (found.cleaned.time[-1] - first) / 4 else 0.15
            axes.axvspan(
                middle - half,
                middle + half,
                color=_FAULT_COLOURS[fault.kind],
                alpha=alpha,
                linewidth=0,
                zorder=0.5,
            )


def _pose(axes: Axes, found: Inspection) -> None:
    time, raw = found.cleaned.time - found.cleaned.time[0], found.cleaned
    moved = 1e3 * (raw.position - raw.position[0])
    for axis, colour in enumerate(_AXIS_COLOURS):
        axes.plot(time, moved[:, axis], color=colour, linewidth=0.8, label=f"${'xyz'[axis]}$")
    axes.set_ylabel("moved [mm]")
    axes.set_xlabel("time since the first stamp [s]")
    turned = np.degrees(
        np.linalg.norm(
            rotation_vectors(
                np.broadcast_to(raw.orientation[0], raw.orientation.shape), raw.orientation
            ),
            axis=1,
        )
    )
    if turned.max() > 0.01:
        twin = axes.twinx()
        twin.plot(time, turned, color="0.35", linewidth=0.8, linestyle="--", label="turned")
        twin.set_ylabel("turned [°]")
    _shade(axes, found, {"position", "orientation", "time"})
    axes.legend(
        loc="upper left",
        bbox_to_anchor=(1.075 if turned.max() > 0.01 else 1.005, 1.0),
        handlelength=1.2,
        borderaxespad=0,
    )
    axes.set_xlim(time[0], time[-1])


def _spectrum(axes: Axes, found: Inspection, sensor: Sensor, first: int) -> None:
    """Welch's estimate over the longest rest, against the density of the stated noise and rounding,
    with its pink part.
    """
    factor, unit = (
        (1e3, r"mN/$\sqrt{\mathrm{Hz}}$") if first == 0 else (1e6, r"µN m/$\sqrt{\mathrm{Hz}}$")
    )
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"{'force' if first == 0 else 'torque'} [{unit}]")
    axes.set_title("noise at rest")
    intervals = (
        found.tare.intervals
        if found.tare is not None and found.tare.intervals
        else found.rest.intervals
    )
    chosen = max(intervals, key=lambda part: part[1] - part[0], default=None)
    rows = np.zeros(len(found.usable), dtype=bool)
    if chosen is not None:
        rows = (found.cleaned.time >= chosen[0]) & (found.cleaned.time < chosen[1]) & found.usable
    count = int(np.count_nonzero(rows))
    if count < _FEWEST:
        axes.text(0.5, 0.5, "no rest", transform=axes.transAxes, ha="center", va="center")
        axes.set(xticks=[], yticks=[])
        return
    segment = min(_LONGEST_SEGMENT, max(_FEWEST, count // 4))
    for channel in range(first, first + 3):
        frequency, density = welch(
            found.cleaned.wrench[rows, channel], fs=found.rate, nperseg=segment, detrend="linear"
        )
        inner = slice(1, -1)
        axes.loglog(
            frequency[inner],
            factor * np.sqrt(density[inner]),
            color=_AXIS_COLOURS[channel - first],
            linewidth=0.8,
        )
    if sensor.force_noise is not None:
        white, own = (
            np.asarray(part)[first : first + 3] * 2 / found.rate
            for part in (sensor.reading_variance, sensor.noise.white**2)
        )
        stated = white + own * sensor.noise_corner / frequency[1:, None]
        for axis_noise in np.unique(factor * np.sqrt(stated), axis=1).T:
            axes.loglog(
                frequency[1:],
                axis_noise,
                color="black",
                linestyle="--",
                linewidth=0.9,
                label="stated",
            )
        axes.legend(handles=[axes.lines[-1]], loc="best")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        axis.set_major_locator(
            LogLocator(subs=(1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,), numticks=8)
        )
        axis.set_major_formatter(FormatStrFormatter("%g"))
        axis.set_minor_formatter(NullFormatter())
    low, high = axes.get_ylim()
    middle = np.sqrt(low * high)
    axes.set_ylim(min(low, middle / _LEAST_SPAN), max(high, middle * _LEAST_SPAN))


def _legend(found: Inspection) -> list[Patch]:
    kinds = [kind for kind in _FAULT_COLOURS if any(fault.kind is kind for fault in found.faults)]
    tare = (
        [Patch(color=_TARE_COLOUR, label="tare")]
        if found.tare is not None and found.tare.intervals
        else []
    )
    return tare + [Patch(color=_FAULT_COLOURS[kind], alpha=0.45, label=str(kind)) for kind in kinds]
