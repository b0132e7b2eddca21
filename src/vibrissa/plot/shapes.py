"""A fitted surface, coloured by how well it is known or by how it differs from a model."""

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot as plt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from vibrissa.geometry.checks import positive
from vibrissa.plot.style import COLUMN
from vibrissa.shape import Comparison, ShapeMesh
from vibrissa.shape.compare import DIVERGING, UNCERTAIN

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
    axes = _prepared(mesh, axes)
    deviation = _MILLIMETRES * mesh.deviation[mesh.faces].mean(axis=1)
    low, high = np.quantile(deviation, (0.02, 0.98))
    norm = LogNorm(low, max(high, 1.5 * low))
    _draw(axes, mesh, plt.get_cmap("viridis_r")(norm(deviation))[:, :3], view)
    _bar(axes, ScalarMappable(norm, "viridis_r"), "standard deviation [mm]")
    return axes


def comparison_figure(
    comparison: Comparison,
    axes: Axes3D | None = None,
    *,
    view: tuple[float, float] = _VIEW,
    limit: float | None = None,
) -> Axes3D:
    """Draw where a fitted part differs from its CAD model: blue where it has too little material,
    red where it has too much, grey where the difference is not significant.

    Parameters
    ----------
    comparison
        From `vibrissa.compare`, in metres.
    axes
        Axes in space to draw into; by default new ones.
    view
        Elevation and azimuth of the eye [°].
    limit
        Distance [m] at which colours end, on both sides; by default `Comparison.limit`.

    Raises
    ------
    ValueError
        If the mesh has no triangle, or the limit is not positive.
    """
    mesh = comparison.mesh
    axes = _prepared(mesh, axes)
    end = comparison.limit if limit is None else positive(limit, "limit")
    colours = comparison.colours(end)[mesh.faces].mean(axis=1) / 255
    _draw(axes, mesh, colours, view)
    mapped = ScalarMappable(
        Normalize(-_MILLIMETRES * end, _MILLIMETRES * end),
        LinearSegmentedColormap.from_list("difference", DIVERGING),
    )
    _bar(axes, mapped, "distance from the model [mm]")
    if not comparison.significant.all():
        axes.legend(
            [Patch(color=tuple(UNCERTAIN.tolist()))],
            ["not significant"],
            loc="upper left",
            borderaxespad=0,
        )
    return axes


def _prepared(mesh: ShapeMesh, axes: Axes3D | None) -> Axes3D:
    """The axes, or new ones, once the mesh is checked."""
    if not len(mesh.faces):
        raise ValueError("mesh has no triangle; allowed is a surface that was touched")
    if axes is None:
        figure = plt.figure(figsize=(1.6 * COLUMN, 1.2 * COLUMN))
        axes = figure.add_subplot(projection="3d")
        axes.set_proj_type("ortho")
    return axes


def _draw(
    axes: Axes3D, mesh: ShapeMesh, colours: Float[np.ndarray, "f 3"], view: tuple[float, float]
) -> None:
    """Draw shaded triangles and set the axes around them, in millimetres."""
    elevation, azimuth = np.radians(view)
    eye = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    eye[2] = np.sin(elevation)
    facing = mesh.normal[mesh.faces].mean(axis=1) @ eye
    shaded = colours * (_AMBIENT + (1 - _AMBIENT) * np.abs(facing))[:, None]
    axes.add_collection3d(
        Poly3DCollection(
            _MILLIMETRES * mesh.vertices[mesh.faces],
            facecolors=shaded,
            edgecolors=shaded,
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


def _bar(axes: Axes3D, mapped: ScalarMappable, label: str) -> None:
    """Add the scale of colours, open at both ends."""
    bar = axes.figure.colorbar(mapped, ax=axes, shrink=0.65, pad=0.2, extend="both")
    bar.set_label(label)
