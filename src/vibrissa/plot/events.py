"""Reactions along one trail, with its events."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from vibrissa.contacts import Status
from vibrissa.forward import EventKind, Scan
from vibrissa.plot.style import COLUMN, length_factor, length_label

MARKERS = dict(zip(EventKind, "osDvX^<P>d*", strict=True))


def reactions_along(scan: Scan) -> list[Axes]:
    """Contact force and arc length over the clamp's x0 on one trail (n, …), with its events; dashed
    where the branch is laterally unstable.
    """
    factor = length_factor(scan.rod)
    x = factor * scan.trail.position[:, 0]
    force = np.where(scan.in_contact, np.linalg.norm(scan.reactions.force, axis=-1), np.nan)
    rows = [
        (force, "$f$ [N]" if scan.rod.units == "SI" else "$f$ [$EI/L^2$]"),
        (factor * scan.arc_length, length_label("s_1", scan.rod)),
    ]
    figure, panels = plt.subplots(
        2, 1, figsize=(COLUMN * 1.25, COLUMN * 1.25), sharex=True, layout="constrained"
    )
    unstable = scan.status == Status.LATERALLY_UNSTABLE
    branches = ((unstable, "-", "stable"), (~unstable, (0, (3, 2)), "laterally unstable"))
    for axes, (values, label) in zip(panels, rows, strict=True):
        for left_out, style, name in branches[: 1 + unstable.any()]:
            shown = np.where(left_out, np.nan, values)
            axes.plot(x, shown, color="black", linestyle=style, label=name)
        axes.set_ylabel(label)
        known = np.isfinite(values)
        order = np.argsort(x[known])
        for event in scan.events:
            at, name = factor * event.clamp[0], event.kind.name.lower().replace("_", " ")
            value = np.interp(at, x[known][order], values[known][order])
            marker = MARKERS[event.kind]
            axes.plot(at, value, marker, color="#c1121f", markersize=5, label=name, clip_on=False)
    panels[-1].set_xlabel(length_label("x_0", scan.rod))
    panels[-1].invert_xaxis()
    handles, names = panels[0].get_legend_handles_labels()
    once = dict(zip(names, handles, strict=True))
    figure.legend(once.values(), once.keys(), loc="outside upper center", ncols=2, handlelength=1.8)
    return list(panels)
