"""A fitted surface, coloured by how well it is known."""

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from vibrissa.plot.style import COLUMN
from vibrissa.shape import ShapeMesh

_MILLIMETRES = 1e3
_VIEW = 22.0, -55.0
"""Elevation and azimuth [°]."""
_AMBIENT = 0.55
"""Brightness of a face seen edge-on."""


def shape_figure(
    mesh: ShapeMesh, axes: Axes3D | None = None, *, view: tuple[float, float] = _VIEW
) -> Axes3D:
    """Draw the mesh of a fitted surface in space, coloured by its standard deviation.

    Parameters
    ----------
    mesh
        From `Shape.mesh`, in metres.
    axes
        Axes in space to draw into; by default new ones.
    view
        Elevation and azimuth of the eye [°].

    Raises
    ------
    ValueError
        If the mesh has no triangle.
    """
    if not len(mesh.faces):
        raise ValueError("mesh has no triangle; allowed is a surface that was touched")
    if axes is None:
        figure = plt.figure(figsize=(1.6 * COLUMN, 1.2 * COLUMN))
        axes = figure.add_subplot(projection="3d")
        axes.set_proj_type("ortho")
    elevation, azimuth = np.radians(view)
    eye = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    eye[2] = np.sin(elevation)
    corners, facing = mesh.faces, mesh.normal[mesh.faces].mean(axis=1) @ eye
    deviation = _MILLIMETRES * mesh.deviation[corners].mean(axis=1)
    low, high = np.quantile(deviation, (0.02, 0.98))
    norm = LogNorm(low, max(high, 1.5 * low))
    colours = plt.get_cmap("viridis_r")(norm(deviation))
    colours[:, :3] *= (_AMBIENT + (1 - _AMBIENT) * np.abs(facing))[:, None]
    axes.add_collection3d(
        Poly3DCollection(
            _MILLIMETRES * mesh.vertices[corners],
            facecolors=colours,
            edgecolors=colours,
            linewidths=0.2,
        )
    )
    low_corner, high_corner = (
        _MILLIMETRES * edge(mesh.vertices, axis=0) for edge in (np.min, np.max)
    )
    margin = 0.03 * np.max(high_corner - low_corner)
    for name, first, last in zip("xyz", low_corner, high_corner, strict=True):
        getattr(axes, f"set_{name}lim")(first - margin, last + margin)
        getattr(axes, f"set_{name}label")(f"${name}$ [mm]")
        getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(4))
    axes.set_box_aspect(np.maximum(high_corner - low_corner, margin) + 2 * margin)
    axes.view_init(*view)
    bar = axes.figure.colorbar(
        ScalarMappable(norm, "viridis_r"), ax=axes, shrink=0.65, pad=0.2, extend="both"
    )
    bar.set_label("standard deviation [mm]")
    return axes
