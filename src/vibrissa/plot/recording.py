"""A recording with its tare, faults, noise and pose."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator
from scipy.signal import welch

from vibrissa.geometry.rotation import rotation_vectors
from vibrissa.plot.arguments import checked
from vibrissa.plot.style import AXIS_COLOURS, PAGE
from vibrissa.sensor import CHANNELS, FaultKind, Inspection, Sensor

_TARE_COLOUR = "#bcd9ea"
# Hatched too, for colour-blind readers.
_FAULTS = {
    FaultKind.SATURATION: ("#e07b00", "///"),
    FaultKind.DROP_OUT: ("#7a3e9d", ""),
    FaultKind.STUCK: ("#8c6d31", "\\\\\\"),
    FaultKind.HELD: ("#c77cba", "---"),
    FaultKind.GAP: ("#555555", "xxx"),
    FaultKind.DUPLICATE: ("#d0a000", "|||"),
    FaultKind.BACKWARD: ("#a00000", "..."),
    FaultKind.POSE_JUMP: ("#00808a", "+++"),
}
_UNUSED = 0.35
# Channels, name, symbol, factor and unit of the readings, factor and unit of their noise.
_KINDS = (
    (slice(0, 3), "force", "f", 1.0, "N", 1e3, r"mN/$\sqrt{\mathrm{Hz}}$"),
    (slice(3, 6), "torque", r"\tau", 1e3, "N mm", 1e6, r"µN m/$\sqrt{\mathrm{Hz}}$"),
)
_LONGEST_SEGMENT = 4096  # samples per segment of a spectrum: resolves half a hertz at 2 kHz
_FEWEST = 32  # samples per segment: a density over a decade and more
_LARGEST = 1e12  # loggers mark missing numbers with larger ones
# At least half a decade to either side, so that noise that follows its density looks flat.
_LEAST_SPAN = 10**0.5
# Ratio of largest to least beyond which only decades are labelled.
_FEW_DECADES = 1e3


@mpl.rc_context({"axes.prop_cycle": f"cycler(color={AXIS_COLOURS})", "lines.linewidth": 0.8})
@checked
def recording_figure(found: Inspection, sensor: Sensor) -> list[Axes]:
    """Force and torque over time as logged, with tare intervals and faults shaded; the sensor's
    pose; and the noise's amplitude spectral density at rest.

    Parameters
    ----------
    found
        Result of `vibrissa.sensor.inspect_raw`; unusable rows are drawn faint.
    sensor
        Gives the stated noise.

    Raises
    ------
    ValueError
        If the recording has a single row, or no number in any of its readings.
    """
    rows = len(found.raw.time)
    if rows < 2 or not np.isfinite(found.raw.wrench).any():
        raise ValueError(
            f"nothing to draw: {rows} row{'s' * (rows > 1)}, of which "
            f"{np.isfinite(found.raw.wrench).any(axis=1).sum()} hold readings; allowed are at "
            "least two rows, and readings"
        )
    figure, axes = plt.subplot_mosaic(
        [["force"] * 2, ["torque"] * 2, ["pose"] * 2, ["noise of force", "noise of torque"]],
        figsize=(PAGE, 5.8),
        height_ratios=(1.2, 1.2, 0.9, 1.1),
        layout="constrained",
    )
    time = found.cleaned.time - found.cleaned.time[0]
    logged = np.where(np.abs(found.raw.wrench) < _LARGEST, found.raw.wrench, np.nan)
    for channels, name, symbol, factor, unit, of_noise, density in _KINDS:
        lines, spectrum = axes[name], axes[f"noise of {name}"]
        lines.sharex(axes["pose"])
        lines.plot(time, factor * logged[:, channels], alpha=_UNUSED)
        labels = [f"${symbol}_{axis}$" for axis in "xyz"]
        lines.plot(time, factor * found.cleaned.wrench[:, channels], label=labels)
        lines.set_ylabel(f"{name} [{unit}]")
        lines.tick_params(labelbottom=False)
        _shade(lines, found, CHANNELS[channels])
        _spectrum(spectrum, found, sensor, channels, of_noise)
        spectrum.set(xlabel="frequency [Hz]", ylabel=f"{name} [{density}]")
    _pose(axes["pose"], found)
    found_kinds = {fault.kind for fault in found.faults}
    handles: list[Artist] = [
        Patch(**_filled(kind), label=str(kind)) for kind in _FAULTS if kind in found_kinds
    ]
    if found.tared:
        handles.insert(0, Patch(color=_TARE_COLOUR, label="tare"))
    if not found.usable.all():
        label = f"rows not used ({np.count_nonzero(~found.usable)})"
        handles.append(Line2D([], [], color="black", alpha=_UNUSED, label=label))
    if handles:
        figure.legend(handles=handles, loc="outside upper center", ncols=4, handlelength=1.4)
    return list(axes.values())


def _shade(axes: Axes, found: Inspection, names: Sequence[str], right: float = 1.005) -> None:
    """Shade tare and faults of these channels behind the lines; put the legend at `right`."""
    first, last = found.cleaned.time[[0, -1]]
    for start, stop in found.tared:
        axes.axvspan(
            start - first, stop - first, linewidth=0, color=_TARE_COLOUR, alpha=0.6, zorder=0
        )
    for fault in found.faults:
        if fault.kind in _FAULTS and set(names) & set(fault.channels):
            middle, wide = (fault.start + fault.stop) / 2 - first, abs(fault.stop - fault.start)
            half = max(wide / 2, 0.002 * (last - first))
            # A fault that fills the figure must not hide it.
            style = _filled(fault.kind) | ({} if half < (last - first) / 4 else {"alpha": 0.15})
            axes.axvspan(middle - half, middle + half, zorder=0.5, **style)
    axes.legend(loc="upper left", bbox_to_anchor=(right, 1.0), handlelength=1.2, borderaxespad=0)


def _filled(kind: FaultKind) -> dict[str, Any]:
    colour, hatch = _FAULTS[kind]
    return {
        "facecolor": colour,
        "edgecolor": "white",
        "hatch": hatch,
        "alpha": 0.45,
        "linewidth": 0,
    }


def _pose(axes: Axes, found: Inspection) -> None:
    raw = found.cleaned
    time, moved = raw.time - raw.time[0], 1e3 * (raw.position - raw.position[0])
    axes.plot(time, moved, label=[f"${axis}$" for axis in "xyz"])
    axes.set(ylabel="moved [mm]", xlabel="time since the first stamp [s]", xlim=time[[0, -1]])
    start = np.broadcast_to(raw.orientation[0], raw.orientation.shape)
    turned = np.degrees(np.linalg.norm(rotation_vectors(start, raw.orientation), axis=1))
    turns = turned.max() > 0.01
    if turns:
        twin = axes.twinx()
        twin.plot(time, turned, color="0.35", linestyle="--", label="turned")
        twin.set_ylabel("turned [°]")
    _shade(axes, found, ("position", "orientation", "time"), 1.075 if turns else 1.005)


def _spectrum(
    axes: Axes, found: Inspection, sensor: Sensor, channels: slice, factor: float
) -> None:
    """Welch spectrum over the longest rest, against the density of the stated noise, pink part
    included, and rounding.
    """
    axes.set_title("noise at rest")
    intervals = map(found.cleaned.during, found.tared or found.rest.intervals)
    rows = max(intervals, key=np.count_nonzero, default=np.zeros_like(found.usable))
    wrench = found.cleaned.wrench[rows & found.usable, channels]
    if len(wrench) < _FEWEST:
        axes.text(0.5, 0.5, "no rest", transform=axes.transAxes, ha="center", va="center")
        axes.set(xticks=[], yticks=[])
        return
    segment = min(_LONGEST_SEGMENT, max(_FEWEST, len(wrench) // 4))
    frequency, density = welch(wrench, fs=found.rate, nperseg=segment, detrend="linear", axis=0)
    axes.loglog(frequency[1:-1], factor * np.sqrt(density[1:-1]))
    if sensor.noise.known:
        noise = sensor.noise
        variance = noise.variance + noise.white**2 * noise.noise_corner / frequency[1:, None]
        stated = factor * np.sqrt(2 / found.rate * variance[:, channels])
        axes.loglog(frequency[1:], np.unique(stated, axis=1), "k--", label="stated")
        axes.legend(handles=[axes.lines[-1]], loc="best")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        labelled = (1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,)
        axis.set_major_locator(LogLocator(subs=labelled, numticks=8))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    low, high = axes.get_ylim()
    middle = np.sqrt(low * high)
    axes.set_ylim(min(low, middle / _LEAST_SPAN), max(high, middle * _LEAST_SPAN))
