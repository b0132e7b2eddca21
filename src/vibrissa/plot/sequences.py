"""Contact sequences on the surface (paper, figure 3b)."""

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot as plt
from mpl_toolkits.mplot3d import Axes3D

from vibrissa.forward import Scan
from vibrissa.inverse import Reconstruction
from vibrissa.plot.lines import dress
from vibrissa.plot.style import COLUMN, KIND_COLOURS, KIND_NAMES, length_factor


def contact_sequences(
    scan: Scan,
    found: Reconstruction,
    surface: tuple[Float[np.ndarray, "i j"], Float[np.ndarray, "i j"], Float[np.ndarray, "i j"]],
    *,
    skip: tuple[int, ...] = (),
) -> Axes3D:
    """Reconstructed contacts, one sequence a trail, over the object's surface.

    Parameters
    ----------
    scan, found
        The scan, for its trails and units, and what was reconstructed from its reactions.
    surface
        Grids x, y, z of a patch of the surface, in units of the rod.
    skip
        Trails to leave out.
    """
    figure = plt.figure(figsize=(COLUMN * 1.5, COLUMN * 1.3))
    axes: Axes3D = figure.add_subplot(projection="3d", computed_zorder=False)
    factor = length_factor(scan.rod)
    x, y, z = (factor * part for part in surface)
    axes.plot_surface(
        x,
        y,
        z,
        color="0.88",
        alpha=0.55,
        linewidth=0,
        antialiased=True,
        rstride=1,
        cstride=1,
        zorder=1,
    )
    axes.plot_wireframe(x, y, z, color="0.7", linewidth=0.25, rstride=6, cstride=6, zorder=2)
    shown = [lane for lane in range(len(found.kind)) if lane not in skip]
    for kind, colour in KIND_COLOURS.items():
        rows = found.kind[shown] == kind
        points = factor * found.point[shown][rows]
        axes.scatter(
            *points.T,
            color=colour,
            s=1.6,
            linewidths=0,
            depthshade=False,
            label=KIND_NAMES[kind],
            zorder=3,
        )
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, 0.95), ncols=2, markerscale=4, handletextpad=0.2
    )
    dress(axes, scan)
    return axes
