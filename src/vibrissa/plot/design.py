"""How well a sensor will do, as a map."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from vibrissa.design import ExpectedError
from vibrissa.plot.style import PAGE, length_factor, length_label

_UNDETECTED, _SATURATED = "0.8", "black"


def expected_error_map(error: ExpectedError) -> list[Axes]:
    """The 95 % ellipsoids' longest semi-axis over the clamp positions and over the contact points,
    in the two world axes along which the clamp moves farthest.

    Positions without a contact that could be detected are grey, those at which the sensor saturates
    have a black cross.

    Parameters
    ----------
    error
        Of `vibrissa.expected_error`.

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
            "no contact of the scan is detected; allowed is a scan with a contact whose load exceeds the sensor's noise"
        )
    clamp, point = (
        factor * error.scan.trail.position.reshape(-1, 3),
        factor * error.scan.point.reshape(-1, 3),
    )
    across = sorted(np.argsort(-np.ptp(clamp, axis=0), kind="stable")[:2].tolist())
    low, high = np.quantile(longest[seen], [0.0, 0.98])
    # An ellipsoid larger than the rod says no more than that nothing is known.
    norm = LogNorm(low, max(min(high, factor * rod.length), 1.01 * low))
    figure, panels = plt.subplots(1, 2, figsize=(PAGE, 3.0), layout="constrained")
    for axes, places, title, symbols in zip(
        panels, (clamp, point), ("clamp", "contact point"), ("x_0y_0z_0", "x y z "), strict=True
    ):
        names = (
            [symbols[3 * axis : 3 * axis + 3] for axis in across]
            if symbols.startswith("x_")
            else [symbols.split()[axis] for axis in across]
        )
        if places is clamp:
            axes.plot(
                *places[~seen][:, across].T,
                ".",
                color=_UNDETECTED,
                markersize=2,
                label="not detected",
            )
        shown = axes.scatter(
            *places[seen][:, across].T,
            c=longest[seen],
            norm=norm,
            cmap="viridis_r",
            s=7,
            linewidths=0,
        )
        full = error.saturated.ravel() & seen
        axes.plot(
            *places[full][:, across].T,
            "x",
            color=_SATURATED,
            markersize=2.5,
            markeredgewidth=0.4,
            label="saturated" if full.any() else None,
        )
        axes.set_title(f"over the {title}")
        axes.set_xlabel(length_label(names[0], rod))
        axes.set_ylabel(length_label(names[1], rod))
        axes.set_aspect("equal", adjustable="datalim")
    if not seen.all():
        panels[0].legend(loc="upper left", markerscale=3)
    unit = "[mm]" if rod.units == "SI" else "$/L$"
    figure.colorbar(shown, ax=list(panels), label=f"longest semi-axis, 95 % {unit}", extend="max")
    return list(panels)
