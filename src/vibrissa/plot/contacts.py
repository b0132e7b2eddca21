"""Reconstructed contacts of a recording, from three sides."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection

from vibrissa.contacts import ContactKind
from vibrissa.plot.style import KIND_COLOURS, KIND_NAMES, PAGE, length_factor, length_label
from vibrissa.reconstruct import Reconstruction

# Square root of the 95 % quantile of χ² with two degrees of freedom.
_TWO_DIMENSIONS_95 = 2.4477
_VIEWS = ((0, 1), (0, 2), (1, 2))
_NAMES = "xyz"
_ELLIPSES = 60


def contacts_figure(found: Reconstruction, *, trusted_deviation: float = 0.05) -> list[Axes]:
    """Contacts in the planes xy, xz and yz, with 95 % ellipses of every so many samples where the noise is known.

    Parameters
    ----------
    found
        Any reconstruction.
    trusted_deviation
        Contacts whose largest standard deviation exceeds this many rod lengths are left out: near first contact they may lie anywhere.
    """
    factor = length_factor(found.rod)
    rows = found.in_contact & np.all(np.isfinite(found.point), axis=-1)
    if found.covariance is not None:
        spread = np.zeros(rows.shape)
        spread[rows] = np.sqrt(np.linalg.eigvalsh(found.covariance[rows])[:, -1])
        rows &= spread <= trusted_deviation * found.rod.length
    figure, panels = plt.subplots(1, 3, figsize=(PAGE, 2.9), layout="constrained")
    points, kinds = factor * found.point[rows], found.kind[rows]
    for axes, (first, second) in zip(panels, _VIEWS, strict=True):
        for kind, colour in KIND_COLOURS.items():
            chosen = points[kinds == kind]
            axes.plot(chosen[:, first], chosen[:, second], ".", color=colour, markersize=1.6, label=KIND_NAMES[ContactKind(kind)])
        axes.set_xlabel(length_label(_NAMES[first], found.rod))
        axes.set_ylabel(length_label(_NAMES[second], found.rod))
        axes.set_aspect("equal", adjustable="datalim")
        if found.covariance is not None:
            shown = slice(None, None, max(1, len(points) // _ELLIPSES))
            _ellipses(axes, points[shown], found.covariance[rows][shown] * factor**2, (first, second))
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=2, markerscale=4)
    return list(panels)


def _ellipses(axes: Axes, points: np.ndarray, covariance: np.ndarray, view: tuple[int, int]) -> None:
    if not len(points):
        return
    plane = covariance[:, view, :][:, :, view]
    variances, directions = np.linalg.eigh(plane)
    widths = 2 * _TWO_DIMENSIONS_95 * np.sqrt(variances)
    angles = np.degrees(np.arctan2(directions[:, 1, 1], directions[:, 0, 1]))
    ellipses = EllipseCollection(
        widths[:, 1],
        widths[:, 0],
        angles,
        units="xy",
        offsets=points[:, view],
        offset_transform=axes.transData,
        facecolor="none",
        edgecolor="0.45",
        linewidth=0.4,
        zorder=3,
    )
    axes.add_collection(ellipses, autolim=False)
