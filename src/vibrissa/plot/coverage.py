"""Which part of a surface the contacts cover, seen from above."""

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from vibrissa.plot.style import PAGE

_COVERED, _OPEN = "#9ecae1", "#f0f0f0"


def coverage_figure(
    samples: Float[np.ndarray, "n 3"],
    cases: list[tuple[str, Float[np.ndarray, "_ 3"], Bool[np.ndarray, "_"], float]],
) -> list[Axes]:
    """One panel per case: covered samples, open samples, and the contacts, over x and y in rod
    lengths.

    Parameters
    ----------
    samples
        Points of the surface region (n, 3).
    cases
        For each: name, contacts (k, 3), which samples are covered (n,), and their share.
    """
    every = np.concatenate([contacts[:, :2] for _, contacts, _, _ in cases])
    span = 1.04 * np.nanmax(np.abs(every), axis=0)
    _, panels = plt.subplots(
        1, len(cases), figsize=(PAGE, 2.2), sharey=True, layout="constrained", squeeze=False
    )
    for axes, (name, contacts, covered, share) in zip(panels[0], cases, strict=True):
        for rows, colour in ((~covered, _OPEN), (covered, _COVERED)):
            axes.scatter(*samples[rows, :2].T, s=1.2, color=colour, linewidths=0, rasterized=True)
        axes.plot(*contacts[:, :2].T, ".", color="black", markersize=0.5)
        axes.set(title=f"{name}: {share:.0%}", xlabel="$x/L$", aspect="equal")
        axes.set(xlim=(-span[0], span[0]), ylim=(-span[1], span[1]))
    panels[0, 0].set_ylabel("$y/L$")
    return list(panels[0])
