"""Rods, contacts and the object in space."""

from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from jaxtyping import Bool, Float
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d import Axes3D, proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from vibrissa.contacts import ContactKind, Status
from vibrissa.forward import Scan
from vibrissa.inverse import Reconstruction
from vibrissa.plot.lines import dress
from vibrissa.plot.style import COLUMN, KIND_COLOURS, KIND_NAMES, length_factor
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.surfaces.outline import box_of, outline

_PAINT = np.array([0.84, 0.87, 0.90])
_STRAIGHT, _FREE = "black", "0.6"
_FORCE, _NORMAL, _UNCERTAIN = "#d97706", "#2a7f3f", "0.3"
_SAMPLES = 90
"""Points of a drawn rod: its segments are invisible at the width of a page."""
_RODS = 20
"""Rods drawn of a trail, unless told otherwise."""
_AXES_95 = 2.7955
"""Square root of the 95 % quantile of χ² with three degrees of freedom."""
_ARROW = 0.2
"""Length of a drawn direction, in rod lengths."""

Box = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]


class _View(NamedTuple):
    """Where the scene is seen from, and what may hide parts of it."""

    towards: Float[np.ndarray, "3"]
    """Unit vector towards the eye."""
    surface: Surface | None
    box: Box

    def seen(self, points: Float[np.ndarray, "n 3"], reach: float) -> Bool[np.ndarray, "n"]:
        """Whether nothing of the object, as far as it is drawn, hides these points."""
        if self.surface is None or not len(points):
            return np.ones(len(points), dtype=bool)
        low, high = self.box
        far = np.linspace(0.012, 2.5, 250) * max(reach, np.linalg.norm(high - low) / 2.5)
        way = points[:, None] + far[:, None] * self.towards
        drawn = np.all((way > low) & (way < high), axis=-1)
        hidden = np.zeros(drawn.shape, dtype=bool)
        hidden[drawn] = self.surface.levels(way[drawn]) < 0
        return np.asarray(~hidden.any(axis=1))


def scene(
    what: Scan | Reconstruction,
    *,
    surface: Surface | None = None,
    box: tuple[tuple[float, ...], tuple[float, ...]] | None = None,
    every: int | None = None,
    view: tuple[float, float] = (15.0, -55.0),
    directions: bool = False,
    axes: Axes3D | None = None,
) -> Axes3D:
    """A sweep in space: object, rods, contact points with their uncertainty, and trails.

    Rods are red in tip contact, blue in tangential contact, black where they are straight, grey
    without contact, and faint behind the object. Contacts whose status is not OK are crosses. Known
    uncertainties are drawn as the principal axes of 95 % ellipsoids.

    Parameters
    ----------
    what
        Scan, or reconstruction with or without smoothing; of one trail or several.
    surface
        Object, in units of the rod; by default that of a scan. A reconstruction knows none.
    box
        Least and largest coordinates of the part of the object to draw, in units of the rod; by
        default what surrounds the contacts.
    every
        Number of positions from one drawn rod to the next; by default 20 rods for each trail.
    view
        Elevation and azimuth of the eye [°].
    directions
        Whether to draw the object's normal and the direction of the force at the drawn rods.
    axes
        Axes in space to draw in; by default those of a new figure.

    Returns
    -------
    Axes3D
        Axes in millimetres, or in rod lengths for a rod in model units.

    Raises
    ------
    ValueError
        If there is nothing to draw; the message counts the rows by status.
    ImportError
        If there is an object to draw and `vibrissa[mesh]` is not installed.
    """
    if isinstance(what, Scan):
        surface, position = surface or what.surface, what.trail.position
    else:
        position = what.reactions.trail.position
    rod, count = what.rod, position.shape[-2]
    axes = axes if axes is not None else _space()
    elevation, azimuth = np.radians(view)
    level = np.cos(elevation)
    towards = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    touched = what.point[what.in_contact & np.isfinite(what.point).all(axis=-1)]
    around = touched if len(touched) else position.reshape(-1, 3)
    if surface is None:
        edges = around.min(axis=0), around.max(axis=0)
    else:
        edges = box_of(surface, around, rod.length) if box is None else tuple(map(np.asarray, box))
    seen_from = _View(towards, surface, edges)
    rows = _drawn_rows(what, every or max(1, count // _RODS))
    lines = _draw_rods(axes, what, rows, seen_from)
    if not len(lines) and not len(touched):
        codes, counts = np.unique(what.status, return_counts=True)
        said = [f"{n} {Status(code).name}" for code, n in zip(codes, counts, strict=True)]
        raise ValueError(f"nothing to draw: {', '.join(said)}; no rod is solved, no contact found")
    shown = [length_factor(rod) * position.reshape(-1, 3), lines]
    if surface is not None:
        shown.append(_draw_object(axes, surface, seen_from, rod))
    for trail in position.reshape(-1, count, 3):
        axes.plot(*(length_factor(rod) * trail).T, color=_FREE, linewidth=0.6, zorder=0)
    handles = _draw_contacts(axes, what, seen_from)
    if directions:
        handles += _draw_directions(axes, what, rows, seen_from)
    _frame(axes, rod, np.vstack(shown), view, handles)
    return axes


def _space() -> Axes3D:
    figure = plt.figure(figsize=(1.7 * COLUMN, 1.25 * COLUMN))
    axes: Axes3D = figure.add_subplot(projection="3d", computed_zorder=False)
    axes.set_proj_type("ortho")
    return axes


def _drawn_rows(what: Scan | Reconstruction, every: int) -> Bool[np.ndarray, "*trail n"]:
    """Every so many positions, those whose rod is known."""
    rows = np.zeros(what.kind.shape, dtype=bool)
    rows[..., ::every] = True
    rows &= np.isfinite(what.energy)
    if isinstance(what, Reconstruction):
        rows &= what.in_contact & np.isfinite(what.point).all(axis=-1)
    return rows


def _draw_object(
    axes: Axes3D, surface: Surface, view: _View, rod: Rod
) -> Float[np.ndarray, "n 3"]:
    """The object, shaded; returns its corners as drawn."""
    own, cut = outline(surface, *view.box)
    towards, factor = view.towards, length_factor(rod)
    upwards = np.array([0, 0, 1]) - towards[2] * towards
    light = towards + (0.6 * upwards - 0.3 * np.cross(upwards, towards)) / np.linalg.norm(upwards)
    light /= np.linalg.norm(light)
    across = np.cross(cut[:, 1] - cut[:, 0], cut[:, 2] - cut[:, 0])
    flat = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(float).tiny)
    for triangles, normals, order in (
        (own, surface.normal(own.mean(axis=1)), 1.0),
        (cut, flat, 1.5),
    ):
        if not len(triangles):
            continue
        # Cuts are seen from outside only: the sign of their normals is that of the box's side.
        middle = triangles.mean(axis=1) - np.mean(view.box, axis=0)
        outwards = normals if order == 1.0 else normals * np.sign((normals * middle).sum(-1))[:, None]
        facing = outwards @ towards > 0 if order > 1 or not len(cut) else np.ones(len(own), bool)
        colours = np.clip(_PAINT * (0.55 + 0.5 * np.abs(normals[facing] @ light)[:, None]), 0, 1)
        polygons = Poly3DCollection(
            factor * triangles[facing],
            facecolors=colours,
            edgecolors=colours,
            linewidths=0.25,
            zorder=order,
            clip_on=False,
        )
        axes.add_collection3d(polygons)
    return factor * np.concatenate([own, cut]).reshape(-1, 3)


def _draw_rods(
    axes: Axes3D, what: Scan | Reconstruction, rows: Bool[np.ndarray, "*trail n"], view: _View
) -> Float[np.ndarray, "n 3"]:
    """Rods at some rows; returns their points as drawn."""
    rod, pieces, colours = what.rod, [], []
    s = np.linspace(0, rod.length, _SAMPLES)[:-1]
    for at in zip(*np.nonzero(rows), strict=True):
        line = what.elastic_line(at if len(at) > 1 else at[0], _SAMPLES)
        bent = s < np.nan_to_num(what.arc_length[at])
        rest = _STRAIGHT if what.in_contact[at] else _FREE
        pieces.append(np.stack([line[:-1], line[1:]], axis=1))
        colours.append(np.where(bent, KIND_COLOURS.get(ContactKind(int(what.kind[at])), rest), rest))
    if not pieces:
        return np.zeros((0, 3))
    segments, colour = np.concatenate(pieces), np.concatenate(colours)
    seen = view.seen(segments.mean(axis=1), rod.length)
    for part, alpha, order in ((~seen, 0.22, 2), (seen, 1.0, 3)):
        collection = Line3DCollection(
            length_factor(rod) * segments[part],
            colors=colour[part],
            linewidths=0.7,
            alpha=alpha,
            zorder=order,
            capstyle="round",
            clip_on=False,
        )
        if part.any():
            axes.add_collection3d(collection)
    drawn: Float[np.ndarray, "n 3"] = length_factor(rod) * segments.reshape(-1, 3)
    return drawn


def _draw_contacts(axes: Axes3D, what: Scan | Reconstruction, view: _View) -> list[Line2D]:
    """Contact points and their uncertainty; returns what the legend shows."""
    factor, handles = length_factor(what.rod), []
    known = what.in_contact & np.isfinite(what.point).all(axis=-1)
    for kind, paint in KIND_COLOURS.items():
        own = known & (what.kind == kind)
        if not own.any():
            continue
        handles.append(Line2D([], [], color=paint, label=f"{KIND_NAMES[kind]} ({own.sum()})"))
        dark = np.array(mpl.colors.to_rgb(paint)) * 0.6
        for good, marker, size in ((True, ".", 1.6), (False, "x", 2.0)):
            points = what.point[own & ((what.status == Status.OK) == good)]
            points = points[view.seen(points, what.rod.length)]
            style = {"marker": marker, "markersize": size, "markeredgewidth": 0 if good else 0.4}
            axes.plot(*(factor * points).T, linestyle="none", color=dark, zorder=4, **style)
    flagged = int((known & (what.status != Status.OK)).sum())
    if flagged:
        cross = {"marker": "x", "linestyle": "none", "markersize": 4}
        handles.append(Line2D([], [], color="0.2", label=f"status not OK ({flagged})", **cross))
    covariance = what.covariance if isinstance(what, Reconstruction) else None
    if covariance is not None:
        handles += _draw_uncertainty(axes, what, known & np.isfinite(covariance).all(axis=(-2, -1)))
    return handles


def _draw_uncertainty(
    axes: Axes3D, found: Reconstruction, rows: Bool[np.ndarray, "*trail n"]
) -> list[Line2D]:
    """Principal axes of ellipsoids that hold a contact with 95 %; faint if longer than a tenth of
    the rod.
    """
    assert found.covariance is not None
    variances, axes_of = np.linalg.eigh(found.covariance[rows])
    half = _AXES_95 * np.sqrt(np.maximum(variances, 0))[:, None] * axes_of
    center = found.point[rows][:, None]
    ends = np.stack([center - half.swapaxes(1, 2), center + half.swapaxes(1, 2)], axis=2)
    wide = np.linalg.norm(half[..., -1], axis=1) > found.rod.length / 10
    handles = []
    for part, alpha, name in ((~wide, 0.6, "95 % ellipsoids"), (wide, 0.12, "wider than L/10")):
        if not part.any():
            continue
        strokes = length_factor(found.rod) * ends[part].reshape(-1, 2, 3)
        axes.add_collection3d(
            Line3DCollection(strokes, colors=_UNCERTAIN, linewidths=0.4, alpha=alpha, zorder=3.5)
        )
        label = f"{name} ({part.sum()})"
        handles.append(Line2D([], [], color=_UNCERTAIN, alpha=alpha, linewidth=0.6, label=label))
    return handles


def _draw_directions(
    axes: Axes3D, what: Scan | Reconstruction, rows: Bool[np.ndarray, "*trail n"], view: _View
) -> list[Line2D]:
    rows = rows & what.in_contact
    rows[rows] = view.seen(what.point[rows], what.rod.length)
    handles = []
    for vectors, colour, label in (
        (what.normal, _NORMAL, "normal"),
        (what.force_direction, _FORCE, "force on the rod"),
    ):
        ends = what.point[rows] + _ARROW * what.rod.length * vectors[rows]
        arrows = length_factor(what.rod) * np.stack([what.point[rows], ends], axis=1)
        axes.add_collection3d(
            Line3DCollection(arrows, colors=colour, linewidths=0.9, zorder=5, clip_on=False)
        )
        handles.append(Line2D([], [], color=colour, label=label))
    return handles


def _frame(
    axes: Axes3D,
    rod: Rod,
    shown: Float[np.ndarray, "n 3"],
    view: tuple[float, float],
    handles: list[Line2D],
) -> None:
    low, high = shown.min(axis=0), shown.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    dress(axes, rod)
    axes.view_init(*view)
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.canvas.draw()
    limits = np.meshgrid(axes.get_xlim(), axes.get_ylim(), axes.get_zlim())
    across, up, _ = proj3d.proj_transform(*np.array(limits).reshape(3, -1), axes.get_proj())
    corners = axes.transData.transform(np.column_stack([across, up]))
    top = axes.transAxes.inverted().transform(corners)[:, 1].max()
    handles.append(Line2D([], [], color=_STRAIGHT, linewidth=0.6, label="straight part"))
    place = {"loc": "lower center", "bbox_to_anchor": (0.5, float(top) + 0.02)}
    axes.legend(handles=handles, ncols=2, handlelength=1.4, columnspacing=1.4, **place)
