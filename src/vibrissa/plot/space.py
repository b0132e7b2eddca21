"""Drawing in space with matplotlib, which sorts by layers: what the object hides is found here."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from jaxtyping import Bool, Float
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from vibrissa.contacts import Contacts, Status
from vibrissa.drawing import BEHIND, FREE, KIND_COLOURS, KIND_NAMES, half_axes, length_factor
from vibrissa.forward.events import Event
from vibrissa.plot.events import MARKERS
from vibrissa.plot.style import COLUMN, corners_of, length_label
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface

FORCE, NORMAL = "#d97706", "#2a7f3f"
_UNCERTAIN = "0.3"
_PAINT = np.array([0.84, 0.87, 0.90])
_WIDE = 0.1
"""Half-axis of an ellipsoid, in rod lengths, from which a contact says little."""
_END_ON = 0.98
"""Component of the line of sight along an axis, from which on the axis is not drawn."""
_HIDDEN = 0.22
"""Opacity of a rod behind the object."""

_EYES = tuple((height, -55.0 + turn) for height in (15.0, -15.0) for turn in (0, 90, 180, 270))
"""Elevations and azimuths [°] of which one is chosen."""

View = tuple[float, float]
Box = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]
Points = Float[np.ndarray, "n 3"]


class Segments(NamedTuple):
    """Straight pieces: their ends (n, 2, 3), the colour of each (n,), and their width [pt]."""

    ends: Float[np.ndarray, "n 2 3"]
    colours: Any
    width: float = 0.7


class Arrows(NamedTuple):
    """Directions in one colour, from some points; of a name in the legend."""

    points: Points
    vectors: Points
    colour: str
    name: str

    @property
    def ends(self) -> Float[np.ndarray, "n 2 3"]:
        """Where each begins and ends."""
        return np.stack([self.points, self.points + self.vectors], axis=1)


NOTHING = Segments(np.zeros((0, 2, 3)), np.zeros(0, dtype="U7"))


@dataclass
class Stage:
    """Axes in space, and the eye that looks at them; all that is drawn is in units of the rod."""

    axes: Axes3D
    rod: Rod
    view: View
    surface: Surface | None
    box: Box
    handles: list[Line2D] = field(default_factory=list)

    @classmethod
    def at(
        cls,
        view: View,
        rod: Rod,
        surface: Surface | None,
        box: Box,
        axes: Axes3D | None,
    ) -> "Stage":
        """Axes seen from (elevation, azimuth) [°], by default new ones; of an object, if there is
        one, what lies within a box is drawn.
        """
        if axes is None:
            figure = plt.figure(figsize=(1.7 * COLUMN, 1.25 * COLUMN))
            axes = figure.add_subplot(projection="3d", computed_zorder=False)
            axes.set_proj_type("ortho")
        return cls(axes, rod, view, surface, box)

    @property
    def towards(self) -> Float[np.ndarray, "3"]:
        """Unit vector towards the eye."""
        return _towards(self.view)

    def sees(self, points: Points) -> Bool[np.ndarray, "n"]:
        """Whether nothing of the object, as far as it is drawn, hides these points."""
        if self.surface is None or not len(points):
            return np.ones(len(points), dtype=bool)
        low, high = self.box
        # From just off the surface, so that contacts do not hide behind their own face.
        reach = max(self.rod.length, float(np.linalg.norm(high - low)) / 2.5)
        way = points[:, None] + (np.linspace(0.012, 2.5, 250) * reach)[:, None] * self.towards
        drawn = np.all((way > low) & (way < high), axis=-1)
        hidden = np.zeros(drawn.shape, dtype=bool)
        hidden[drawn] = self.surface.levels(way[drawn]) < 0
        return np.asarray(~hidden.any(axis=1))

    def draw_object(self, triangles: Float[np.ndarray, "f 3 3"]) -> Points:
        """The object, shaded; returns its corners."""
        assert self.surface is not None
        upwards = np.array([0, 0, 1]) - self.towards[2] * self.towards
        aside = np.cross(upwards, self.towards)
        light = self.towards + (0.6 * upwards - 0.3 * aside) / np.linalg.norm(upwards)
        normals = self.surface.normal(triangles.mean(axis=1))
        brightness = np.abs(normals @ light) / np.linalg.norm(light)
        colours = np.clip(_PAINT * (0.55 + 0.5 * brightness[:, None]), 0, 1)
        polygons = Poly3DCollection(
            length_factor(self.rod) * triangles,
            facecolors=colours,
            edgecolors=colours,
            linewidths=0.25,
            zorder=1,
            clip_on=False,
        )
        self.axes.add_collection3d(polygons)
        return triangles.reshape(-1, 3)

    def draw_paths(self, path: Float[np.ndarray, "trail n 3"]) -> None:
        """Paths of the clamp."""
        for trail in length_factor(self.rod) * path:
            self.axes.plot(*trail.T, color=FREE, linewidth=0.6, zorder=0, clip_on=False)

    def draw_rods(self, rods: Segments) -> None:
        """Elastic lines, faint behind the object."""
        seen = self.sees(rods.ends.mean(axis=1))
        for part, alpha, layer in ((~seen, _HIDDEN, 2), (seen, 1.0, 3)):
            if part.any():
                style = {"linewidths": rods.width, "alpha": alpha, "capstyle": "round"}
                self._strokes(rods.ends[part], rods.colours[part], layer, **style)
        for colour, name in ((BEHIND, "behind the contact"), (FREE, "free rod")):
            if np.any(rods.colours == colour):
                self.explain(name, color=colour, linewidth=0.7)

    def draw_contacts(self, contacts: Contacts, size: float) -> None:
        """Contact points, of some size [pt], and their uncertainty."""
        nothing = np.zeros(len(contacts), dtype=int)
        kinds = nothing if contacts.kind is None else contacts.kind
        sound = (nothing if contacts.status is None else contacts.status) == Status.OK
        seen = self.sees(contacts.point)
        for kind in np.unique(kinds):
            own, paint = kinds == kind, KIND_COLOURS.get(kind, "0.3")
            self.explain(f"{KIND_NAMES.get(kind, 'contact')} ({own.sum()})", color=paint)
            dark = np.array(mpl.colors.to_rgb(paint)) * 0.6
            for good, marker, edge in ((True, ".", 0), (False, "x", 0.4)):
                style = {"marker": marker, "markersize": size, "markeredgewidth": edge}
                self._points(contacts.point[own & seen & (sound == good)], color=dark, **style)
        if not sound.all():
            cross = {"color": "0.2", "marker": "x", "linestyle": "none", "markersize": 4}
            self.explain(f"status not OK ({np.sum(~sound)})", **cross)
        if contacts.covariance is not None:
            known = np.isfinite(contacts.covariance).all(axis=(-2, -1))
            self._draw_ellipsoids(contacts[known])

    def _draw_ellipsoids(self, contacts: Contacts) -> None:
        """Principal axes of the 95 % ellipsoids; those of wide ones faint and cut short."""
        half = _half_axes(contacts)
        wide, center = is_wide(contacts, self.rod), contacts.point[:, None, None]
        longest = np.linalg.norm(half, axis=-1, keepdims=True)
        half *= np.minimum(1, 2 * _WIDE * self.rod.length / np.maximum(longest, 1e-300))
        ends = center + np.stack([-half, half], axis=2)
        names = "95 % ellipsoids", "wider than L/10, cut"
        for part, alpha, name in ((~wide, 0.6, names[0]), (wide, 0.12, names[1])):
            if part.any():
                strokes = ends[part].reshape(-1, 2, 3)
                self._strokes(strokes, _UNCERTAIN, 3.5, linewidths=0.4, alpha=alpha, clip_on=True)
                label = f"{name} ({part.sum()})"
                self.explain(label, color=_UNCERTAIN, alpha=alpha, linewidth=0.6)

    def draw_arrows(self, arrows: Arrows) -> None:
        """Directions at points that the eye sees."""
        seen = self.sees(arrows.points)
        self._strokes(arrows.ends[seen], arrows.colour, 5, linewidths=0.9)
        self.explain(arrows.name, color=arrows.colour)

    def draw_events(self, events: Iterable[Event]) -> None:
        """Where something changed: at the contact, or at the clamp if there is none."""
        by_kind: dict[Any, list[Any]] = {}
        for event in events:
            place = event.point if np.isfinite(event.point).all() else event.clamp
            by_kind.setdefault(event.kind, []).append(place)
        for kind in sorted(by_kind):
            style: dict[str, Any] = {
                "marker": MARKERS[kind],
                "color": "black",
                "markerfacecolor": "white",
                "markersize": 3.2,
                "markeredgewidth": 0.6,
            }
            places = np.array(by_kind[kind])
            self._points(places[self.sees(places)], zorder=6, **style)
            label = f"{kind.name.lower().replace('_', ' ')} ({len(places)})"
            self.explain(label, linestyle="none", **style)

    def framed(self, around: Points) -> Axes3D:
        """Limits that hold some points, labels, legend; returns the axes."""
        around = around[np.isfinite(around).all(axis=1)]
        factor = length_factor(self.rod)
        low, high = factor * around.min(axis=0), factor * around.max(axis=0)
        # A sweep in a plane still needs room for the ticks across it, and a point for its error.
        widest = max((high - low).max(), factor * self.rod.length / 2)
        narrow = np.maximum(0.2 * widest - (high - low), 0) / 2
        low, high = low - narrow, high + narrow
        axes = self.axes
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        dress(axes, self.rod)
        axes.view_init(*self.view)
        # An axis seen end-on has all its ticks in one place.
        for axis, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), self.towards, strict=True):
            if abs(share) > _END_ON:
                axis.set_ticks([])
                axis.label.set_visible(False)
        figure = axes.get_figure(root=True)
        assert figure is not None
        figure.canvas.draw()
        _declutter(axes)
        heights = corners_of(axes)[:, 1].tolist()
        # Seen from below, the labels are above.
        boxes = [one.get_tightbbox() for one in (axes.xaxis, axes.yaxis, axes.zaxis)]
        heights += [box.y1 for box in boxes if box is not None]
        top = float(axes.transAxes.inverted().transform((0, max(heights)))[1])
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, top + 0.02)}
        if self.handles:
            style = {"ncols": 2, "handlelength": 1.4, "columnspacing": 1.4}
            axes.legend(handles=self.handles, **style, **place)
        return axes

    def _strokes(
        self, ends: Float[np.ndarray, "n 2 3"], colours: Any, layer: float, **style: Any
    ) -> None:
        if len(ends):  # else matplotlib finds no limits
            style = {"clip_on": False, **style}
            strokes = Line3DCollection(
                length_factor(self.rod) * ends, colors=colours, zorder=layer, **style
            )
            self.axes.add_collection3d(strokes)

    def _points(self, points: Points, **style: Any) -> None:
        style = {"linestyle": "none", "zorder": 4, **style}
        self.axes.plot(*(length_factor(self.rod) * points).T, **style)

    def explain(self, name: str, **style: Any) -> None:
        """Enter a name in the legend."""
        self.handles.append(Line2D([], [], label=name, **style))


def eye_of(contacts: Contacts | None) -> View:
    """From where most contacts face the eye; from above if half of them do."""
    if contacts is None or not len(contacts.point):
        return _EYES[0]
    facing = {eye: np.mean(contacts.normal @ _towards(eye) > 0) for eye in _EYES}
    above = max(_EYES[:4], key=lambda eye: facing[eye])
    return above if facing[above] >= 0.5 else max(_EYES, key=lambda eye: facing[eye])


def _towards(view: View) -> Float[np.ndarray, "3"]:
    elevation, azimuth = np.radians(view)
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def _declutter(axes: Axes3D) -> None:
    """Take away the ticks of drawn axes whose numbers lie on other numbers or names."""
    every = axes.zaxis, axes.xaxis, axes.yaxis
    taken = [axis.label.get_window_extent() for axis in every if axis.label.get_visible()]
    for axis in every:
        kept = []
        for tick in axis.get_major_ticks():
            number = tick.label1.get_window_extent()
            if not number.count_overlaps(taken):
                taken.append(number)
                kept.append(tick.get_loc())
        axis.set_major_locator(FixedLocator(kept))


def is_wide(contacts: Contacts, rod: Rod) -> Bool[np.ndarray, "n"]:
    """Whether the 95 % ellipsoid reaches further than a tenth of the rod; no where unknown."""
    if contacts.covariance is None:
        return np.zeros(len(contacts), dtype=bool)
    reach = np.linalg.norm(_half_axes(contacts), axis=-1).max(axis=-1)
    return np.asarray(reach > _WIDE * rod.length)


def _half_axes(contacts: Contacts) -> Float[np.ndarray, "n 3 3"]:
    """Principal half-axes, one per row, of the ellipsoids that hold a contact with 95 %; zero where
    the covariance is unknown.
    """
    assert contacts.covariance is not None
    return half_axes(np.nan_to_num(contacts.covariance)).swapaxes(1, 2)


def dress(axes: Axes3D, rod: Rod) -> None:
    """Labels, equal aspect, and a quiet background."""
    extents = np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1)
    for name, pad, extent in (
        ("x", 2, extents[0]),
        ("y", 2, extents[1]),
        ("z", -2, 2 * extents[2]),
    ):
        getattr(axes, f"set_{name}label")(length_label(name, rod), labelpad=pad)
        axis = getattr(axes, f"{name}axis")
        axis.set_major_locator(MaxNLocator(nbins=4 if extent > 0.7 * extents.max() else 2))
        axis.set_pane_color((1, 1, 1, 0))
        axis._axinfo["grid"].update(color=(0.85, 0.85, 0.85, 1), linewidth=0.4)
    axes.set_aspect("equal")
    axes.set_box_aspect(extents)
    axes.tick_params(pad=-1)
