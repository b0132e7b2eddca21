"""Maps of how well a sensor will do."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from vibrissa.design import ExpectedError
from vibrissa.drawing import length_factor
from vibrissa.plot.style import PAGE, length_label

_UNDETECTED, _SATURATED = "0.8", "black"


def expected_error_map(error: ExpectedError) -> list[Axes]:
    """The 95 % ellipsoids' longest semi-axis over the clamp positions and over the contact points,
    in the two world axes along which the clamp moves farthest.

    Positions without a detectable contact are grey; those where the sensor saturates have a black
    cross.

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
    places = [
        factor * place.reshape(-1, 3) for place in (error.scan.trail.position, error.scan.point)
    ]
    across = sorted(np.argsort(-np.ptp(places[0], axis=0), kind="stable")[:2].tolist())
    low, high = np.quantile(longest[seen], [0.0, 0.98])
    # An ellipsoid larger than the rod only says that nothing is known.
    norm = LogNorm(low, max(min(high, factor * rod.length), 1.01 * low))
    full = error.saturated.ravel() & seen
    figure, panels = plt.subplots(1, 2, figsize=(PAGE, 3.0), layout="constrained")
    for axes, place, title, index in zip(
        panels, places, ("clamp", "contact point"), ("_0", ""), strict=True
    ):
        flat = place[:, across].T
        if title == "clamp":
            label = "not detected"
            axes.plot(*flat[:, ~seen], ".", color=_UNDETECTED, markersize=2, label=label)
        style = {"norm": norm, "cmap": "viridis_r", "s": 7, "linewidths": 0}
        shown = axes.scatter(*flat[:, seen], c=longest[seen], **style)
        axes.plot(
            *flat[:, full],
            "x",
            color=_SATURATED,
            markersize=2.5,
            markeredgewidth=0.4,
            label="saturated" if full.any() else None,
        )
        names = [length_label("xyz"[axis] + index, rod) for axis in across]
        axes.set(title=f"over the {title}", xlabel=names[0], ylabel=names[1])
        axes.set_aspect("equal", adjustable="datalim")
    if not seen.all():
        panels[0].legend(loc="upper left", markerscale=3)
    unit = "[mm]" if rod.units == "SI" else "$/L$"
    figure.colorbar(shown, ax=list(panels), label=f"longest semi-axis, 95 % {unit}", extend="max")
    return list(panels)
