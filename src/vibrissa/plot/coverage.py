"""Which part of a surface the contacts cover, seen from above."""

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.spatial import KDTree

from vibrissa.geometry.checks import finite_array
from vibrissa.plot.style import PAGE

_OPEN, _COVERED, _CONTACT = "#e3e3e3", "#9ecae1", "#08306b"
_PIXELS = 400
"""Along the longer side of a panel: finer than what is printed."""
_GAP = 4.0
"""In mean distances of the samples: farther from all of them there is no surface."""
_MARGIN = 0.04


def coverage_figure(
    samples: Float[np.ndarray, "n 3"],
    cases: list[tuple[str, Float[np.ndarray, "_ 3"], Bool[np.ndarray, "_"], float]],
    *,
    within: float | None = None,
) -> list[Axes]:
    """One panel per case: the part of the surface that is covered, the part that is not, and the
    contacts on it, over x and y in rod lengths.

    Parameters
    ----------
    samples
        Points of the surface region (n, 3), which is all that is shown.
    cases
        For each: name, contacts (k, 3), which samples are covered (n,), and their share.
    within
        Distance from a contact up to which the surface counts as covered, in rod lengths, for the
        legend.

    Raises
    ------
    ValueError
        If there is no case, the samples do not extend over x and y or are not finite, or the flags
        of a case are not one per sample.
    """
    _check(samples, cases)
    low, high = samples[:, :2].min(axis=0), samples[:, :2].max(axis=0)
    edge = _MARGIN * (high - low).max()
    low, high = low - edge, high + edge
    nearest, surface = _nearest(samples[:, :2], low, high)
    each = (PAGE - 0.5) / len(cases)
    figure, panels = plt.subplots(
        1,
        len(cases),
        figsize=(PAGE, each * (high - low)[1] / (high - low)[0] + 1.15),
        sharey=True,
        layout="constrained",
        squeeze=False,
    )
    for axes, (name, contacts, covered, share) in zip(panels[0], cases, strict=True):
        axes.imshow(
            np.ma.masked_where(~surface, covered[nearest]),
            cmap=ListedColormap([_OPEN, _COVERED]),
            vmin=0,
            vmax=1,
            extent=(low[0], high[0], low[1], high[1]),
            origin="lower",
            interpolation="nearest",
        )
        points = contacts[np.isfinite(contacts).all(axis=1), :2]
        own = points[np.all((points >= low) & (points <= high), axis=1)]
        axes.plot(*own.T, ".", color=_CONTACT, markersize=0.6, markeredgewidth=0, rasterized=True)
        axes.set(title=f"{name}:\n{share:.0%} covered", xlabel="$x/L$")
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    panels[0, 0].set_ylabel("$y/L$")
    distance = "" if within is None else f" (within {within:g} $L$ of a contact)"
    handles = [
        Patch(color=_COVERED, label=f"covered{distance}"),
        Patch(color=_OPEN, label="not covered"),
        Line2D([], [], linestyle="none", marker=".", color=_CONTACT, label="contact"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, handlelength=1.2)
    return list(panels[0])


def _check(
    samples: Float[np.ndarray, "n 3"],
    cases: list[tuple[str, Float[np.ndarray, "_ 3"], Bool[np.ndarray, "_"], float]],
) -> None:
    if not cases:
        raise ValueError("nothing to draw: 0 cases; allowed is at least one")
    places = finite_array(samples, "samples", last=3, ndim=2)[:, :2]
    if len(places) == 0 or not np.all(np.ptp(places, axis=0) > 0):
        raise ValueError(
            f"nothing to draw: {len(places)} sample{'s' * (len(places) != 1)} without an extent "
            "over x and y; allowed are samples of a surface region"
        )
    for name, _, covered, _ in cases:
        if np.shape(covered) != (len(samples),):
            raise ValueError(
                f"cases: covered of {name!r} has the shape {np.shape(covered)}; allowed is "
                f"({len(samples)},), one flag per sample"
            )


def _nearest(
    places: Float[np.ndarray, "n 2"], low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]
) -> tuple[np.ndarray, np.ndarray]:
    """The sample nearest to each pixel, and whether the surface extends to there."""
    size = high - low
    columns, rows = np.ceil(_PIXELS * size / size.max()).astype(int)
    x, y = (
        low[axis] + size[axis] * (np.arange(count) + 0.5) / count
        for axis, count in enumerate((columns, rows))
    )
    distance, nearest = KDTree(places).query(np.stack(np.meshgrid(x, y), axis=-1))
    spacing = np.sqrt(np.prod(np.ptp(places, axis=0)) / len(places))
    return nearest, distance < _GAP / 2 * spacing
