"""Reconstructed contacts of a recording, in three views."""

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection

from vibrissa.contacts import Status
from vibrissa.drawing import KIND_COLOURS, KIND_NAMES, length_factor
from vibrissa.inverse import Reconstruction
from vibrissa.plot.style import PAGE, length_label

# Square root of the 95 % quantile of χ² with two degrees of freedom.
_TWO_DIMENSIONS_95 = 2.4477
_VIEWS = ([0, 1], [0, 2], [1, 2])
_ELLIPSES = 60
_ELLIPSE_COLOUR = "0.45"
_FLAGGED_COLOUR = "#c77700"
# Per cent of the untrusted contacts at each end that do not widen the frame.
_TAIL = 5.0
_MARGIN = 0.06
# Share of the reach, so that a single contact is not magnified without limit.
_LEAST_FRAME = 0.02


def contacts_figure(found: Reconstruction, *, trusted_deviation: float = 0.05) -> list[Axes]:
    """Contacts in the xy, xz and yz planes, with 95 % ellipses every so many samples if the noise
    is known.

    Rows whose status is not OK are crosses. The frame holds all trusted contacts and nine tenths of
    the others; the title says how many lie outside. Without any contact the figure says so and
    shows the path of the clamp.

    Parameters
    ----------
    found
        Any reconstruction.
    trusted_deviation
        Contacts whose largest standard deviation exceeds this many rod lengths are drawn pale: near
        first contact they may lie anywhere.
    """
    rod, factor = found.rod, length_factor(found.rod)
    points, path = (
        factor * place.reshape(-1, 3) for place in (found.point, found.reactions.trail.position)
    )
    kind, status = found.kind.ravel(), found.status.ravel()
    drawn = found.in_contact.ravel() & np.isfinite(points).all(axis=1)
    sound = known = drawn & (status == Status.OK)
    wide, ellipses = factor * trusted_deviation * rod.length, np.zeros(0, dtype=int)
    if found.covariance is not None:
        covariance = factor**2 * found.covariance.reshape(-1, 3, 3)
        known = sound & np.isfinite(covariance).all(axis=(1, 2))
        known[known] = np.linalg.eigvalsh(covariance[known])[:, -1] <= wide**2
        ellipses = np.flatnonzero(known)[:: max(1, np.count_nonzero(known) // _ELLIPSES)]
    frame = _frame(points[known], points[drawn & ~known], path, factor * rod.length)
    layers = []
    for name, colour in KIND_COLOURS.items():
        label, own = KIND_NAMES[name], kind == name
        layers.append((own & known, ".", colour, 1.0, 2.5, label))
        label += f", deviation above {wide:.3g} {'mm' if rod.units == 'SI' else 'L'}"
        layers.append((own & sound & ~known, ".", colour, 0.4, 1.5, label))
    layers.append((drawn & ~sound, "x", _FLAGGED_COLOUR, 0.7, 2, "status not OK"))
    figure, panels = plt.subplots(1, 3, figsize=(PAGE, 2.9), layout="constrained")
    for axes, view in zip(panels, _VIEWS, strict=True):
        for rows, marker, colour, alpha, order, label in layers:
            if rows.any():
                axes.plot(
                    *points[rows][:, view].T,
                    marker,
                    color=colour,
                    alpha=alpha,
                    markersize=2.2,
                    markeredgewidth=0.4 if marker == "x" else 0,
                    label=f"{label} ({np.count_nonzero(rows)})",
                    zorder=order,
                )
        if not drawn.any():
            label = "path of the clamp, no contact"
            axes.plot(*path[:, view].T, color="0.5", linewidth=0.8, label=label)
        labels = [length_label("xyz"[axis], rod) for axis in view]
        axes.set(xlabel=labels[0], ylabel=labels[1], xlim=frame[:, view[0]], ylim=frame[:, view[1]])
        axes.set_aspect("equal", adjustable="box")
        if len(ellipses):
            _ellipses(axes, points[ellipses][:, view], covariance[ellipses][:, view][:, :, view])
    outside = drawn & ~np.all((points >= frame[0]) & (points <= frame[1]), axis=1)
    title = None
    if outside.any():
        title = f"outside of the frame: {outside.sum()} of {drawn.sum()} contacts"
    if not drawn.any():
        flagged = zip(*np.unique(status[status != Status.OK], return_counts=True), strict=True)
        said = [f"{count} {Status(number).name}" for number, count in flagged]
        title = "; ".join([f"no contact in {kind.size} samples", *said])
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside upper center",
        ncols=2,
        markerscale=3,
        title=title,
        title_fontsize=8,
    )
    return list(panels)


def _frame(
    trusted: Float[np.ndarray, "k 3"],
    others: Float[np.ndarray, "m 3"],
    path: Float[np.ndarray, "n 3"],
    reach: float,
) -> Float[np.ndarray, "2 3"]:
    """Least and largest coordinates of the cube to show, within the rod's reach from its clamp."""
    tails = np.percentile(others, [_TAIL, 100 - _TAIL], axis=0) if len(others) else others
    every = np.concatenate([trusted, tails])
    every = every if len(every) else path
    low = np.maximum(every.min(axis=0), path.min(axis=0) - reach)
    high = np.minimum(every.max(axis=0), path.max(axis=0) + reach)
    half = (0.5 + _MARGIN) * max(np.max(high - low), _LEAST_FRAME * reach)
    return (low + high) / 2 + np.array([[-half], [half]])


def _ellipses(
    axes: Axes, centers: Float[np.ndarray, "k 2"], covariance: Float[np.ndarray, "k 2 2"]
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
        linewidth=0.4,
        zorder=3,
    )
    axes.add_collection(ellipses, autolim=False)
    axes.plot(
        [],
        [],
        "o",
        markerfacecolor="none",
        markeredgecolor=_ELLIPSE_COLOUR,
        markeredgewidth=0.4,
        markersize=2,
        label="95 % ellipse",
    )
