"""Reconstructed contacts of a recording, from three sides."""

from collections import Counter
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection

from vibrissa.contacts import ContactKind, Status
from vibrissa.inverse import Reconstruction
from vibrissa.plot.style import KIND_COLOURS, KIND_NAMES, PAGE, length_factor, length_label

# Square root of the 95 % quantile of χ² with two degrees of freedom.
_TWO_DIMENSIONS_95 = 2.4477
_VIEWS = ((0, 1), (0, 2), (1, 2))
_NAMES = "xyz"
_ELLIPSES = 60
_ELLIPSE_COLOUR = "0.45"
_FLAGGED_COLOUR = "#c77700"
# Of the contacts that are not trusted, so many per cent at each end do not widen the frame.
_TAIL = 5.0
_MARGIN = 0.06
# Of the reach: a single contact is not magnified without end.
_LEAST_FRAME = 0.02


class _Chosen(NamedTuple):
    """Which rows are drawn as what."""

    trusted: Bool[np.ndarray, "rows"]
    wide: Bool[np.ndarray, "rows"]
    flagged: Bool[np.ndarray, "rows"]


def contacts_figure(found: Reconstruction, *, trusted_deviation: float = 0.05) -> list[Axes]:
    """Contacts in the planes xy, xz and yz, with 95 % ellipses of every so many samples where the
    noise is known.

    Rows whose status is not OK are crosses. The frame holds all trusted contacts and nine tenths of
    the others; how many lie outside is said. Where there is no contact at all, the figure says so
    and shows the path of the clamp.

    Parameters
    ----------
    found
        Any reconstruction.
    trusted_deviation
        Contacts whose largest standard deviation exceeds this many rod lengths are drawn pale: near
        first contact they may lie anywhere.
    """
    factor = length_factor(found.rod)
    points = factor * found.point.reshape(-1, 3)
    chosen = _chosen(found, trusted_deviation)
    limit = f"{factor * trusted_deviation * found.rod.length:.3g} {'mm' if found.rod.units == 'SI' else 'L'}"
    figure, panels = plt.subplots(1, 3, figsize=(PAGE, 2.9), layout="constrained")
    frame = _frame(found, points, chosen)
    for axes, (first, second) in zip(panels, _VIEWS, strict=True):
        _points(axes, found.kind.reshape(-1), points, chosen, (first, second), limit)
        if not any(rows.any() for rows in chosen):
            path = factor * found.reactions.trail.position.reshape(-1, 3)
            axes.plot(
                path[:, first],
                path[:, second],
                color="0.5",
                linewidth=0.8,
                label="path of the clamp, no contact",
            )
        axes.set_xlabel(length_label(_NAMES[first], found.rod))
        axes.set_ylabel(length_label(_NAMES[second], found.rod))
        axes.set_xlim(frame[0, first], frame[1, first])
        axes.set_ylim(frame[0, second], frame[1, second])
        axes.set_aspect("equal", adjustable="box")
        if found.covariance is not None and chosen.trusted.any():
            shown = np.flatnonzero(chosen.trusted)
            shown = shown[:: max(1, len(shown) // _ELLIPSES)]
            _ellipses(
                axes,
                points[shown],
                found.covariance.reshape(-1, 3, 3)[shown] * factor**2,
                (first, second),
            )
    drawn = chosen.trusted | chosen.wide | chosen.flagged
    outside = drawn & ~np.all((points >= frame[0]) & (points <= frame[1]), axis=1)
    notes = (
        [f"outside of the frame: {np.count_nonzero(outside)} of {np.count_nonzero(drawn)} contacts"]
        if outside.any()
        else []
    )
    if not drawn.any():
        notes = [f"no contact in {found.kind.size} samples" + _statuses(found)]
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(
        handles,
        names,
        loc="outside upper center",
        ncols=2,
        markerscale=3,
        title="\n".join(notes) or None,
        title_fontsize=8,
    )
    return list(panels)


def _chosen(found: Reconstruction, trusted_deviation: float) -> _Chosen:
    place = (found.in_contact & np.all(np.isfinite(found.point), axis=-1)).reshape(-1)
    sound = place & (found.status.reshape(-1) == Status.OK)
    trusted = sound.copy()
    if found.covariance is not None:
        covariance = found.covariance.reshape(-1, 3, 3)
        known = sound & np.isfinite(covariance).all(axis=(1, 2))
        trusted = np.zeros(len(sound), dtype=bool)
        trusted[known] = (
            np.linalg.eigvalsh(covariance[known])[:, -1]
            <= (trusted_deviation * found.rod.length) ** 2
        )
    return _Chosen(trusted, sound & ~trusted, place & ~sound)


def _points(
    axes: Axes,
    kind: np.ndarray,
    points: Float[np.ndarray, "rows 3"],
    chosen: _Chosen,
    view: tuple[int, int],
    limit: str,
) -> None:
    for name, colour in KIND_COLOURS.items():
        for rows, alpha, order, more in (
            (chosen.trusted, 1.0, 2.5, ""),
            (chosen.wide, 0.4, 1.5, f", deviation above {limit}"),
        ):
            part = points[rows & (kind == name)]
            if len(part):
                label = f"{KIND_NAMES[ContactKind(name)]}{more} ({len(part)})"
                axes.plot(
                    *part[:, view].T,
                    ".",
                    color=colour,
                    alpha=alpha,
                    markersize=2.2,
                    markeredgewidth=0,
                    label=label,
                    zorder=order,
                )
    part = points[chosen.flagged]
    if len(part):
        label = f"status not OK ({len(part)})"
        axes.plot(
            *part[:, view].T,
            "x",
            color=_FLAGGED_COLOUR,
            alpha=0.7,
            markersize=2.2,
            markeredgewidth=0.4,
            label=label,
            zorder=2,
        )


def _frame(
    found: Reconstruction, points: Float[np.ndarray, "rows 3"], chosen: _Chosen
) -> Float[np.ndarray, "2 3"]:
    """Least and largest coordinates to show, of a cube, within what the rod can reach from its
    clamp.
    """
    factor = length_factor(found.rod)
    path, reach = factor * found.reactions.trail.position.reshape(-1, 3), factor * found.rod.length
    corners = [points[chosen.trusted]]
    if (chosen.wide | chosen.flagged).any():
        corners.append(
            np.percentile(points[chosen.wide | chosen.flagged], [_TAIL, 100 - _TAIL], axis=0)
        )
    every = np.concatenate(corners)
    if not len(every):
        every = path
    low, high = (
        np.maximum(every.min(axis=0), path.min(axis=0) - reach),
        np.minimum(every.max(axis=0), path.max(axis=0) + reach),
    )
    middle, half = (
        (low + high) / 2,
        (0.5 + _MARGIN) * max(float(np.max(high - low)), _LEAST_FRAME * reach),
    )
    return np.stack([middle - half, middle + half])


def _statuses(found: Reconstruction) -> str:
    """What rows say that are not OK, and how many do."""
    counts = Counter(found.status.reshape(-1).tolist())
    return "".join(
        f"; {count} {Status(status).name}"
        for status, count in counts.items()
        if status != Status.OK
    )


def _ellipses(
    axes: Axes, points: np.ndarray, covariance: np.ndarray, view: tuple[int, int]
) -> None:
    plane = covariance[:, view, :][:, :, view]
    variances, directions = np.linalg.eigh(plane)
    widths = 2 * _TWO_DIMENSIONS_95 * np.sqrt(np.maximum(variances, 0))
    angles = np.degrees(np.arctan2(directions[:, 1, 1], directions[:, 0, 1]))
    ellipses = EllipseCollection(
        widths[:, 1],
        widths[:, 0],
        angles,
        units="xy",
        offsets=points[:, view],
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
