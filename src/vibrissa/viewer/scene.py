"""The scene in the browser: a viser server's nodes, made from a content."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.drawing import half_axes
from vibrissa.viewer.axes import rounded, ticked_box
from vibrissa.viewer.colours import OUTLIER, By, Painter, Scale, rgb, surface_legend
from vibrissa.viewer.content import WIDE, Content, Fitted, Instant, Rows
from vibrissa.viewer.html import legend_html

if TYPE_CHECKING:
    import viser

_PAINT, _TRAIL, _AXIS, _UNCERTAIN = rgb("#c9d1d9"), rgb("#999999"), rgb("#555555"), rgb("#444444")
_POINT, _LINE = 0.012, 3.0
"""Diameter of a contact, in rod lengths, and width of a rod in pixels."""
_HIDING = 1.0
"""Length of an ellipsoid's half axis, in rod lengths, from which it would hide all else and is left
out.
"""
_MOST_ELLIPSOIDS = 1500
"""Shown at once: a browser draws as many without slowing down."""
_NO_PIECES = np.zeros((0, 2, 3))
_FIELD = 0.6
"""Height of the field of view [rad]: little perspective."""
_SHELL = 0.35
"""Opacity of an object beside a fitted surface."""
_SHADES = 256
"""Of a fitted surface: as many as a colour has levels."""
_PICK = 0.006
"""Angle [rad] between a click and a contact: some eight pixels of eight hundred."""


class _Nodes(NamedTuple):
    """Those of one instant's contacts; None if there are none."""

    points: Any
    ellipsoids: Any


class Scene:
    """Nodes of a content in a server's scene; the newest instant is shown.

    Parameters
    ----------
    server
        An empty one.
    content
        What to show.
    by
        What the colours of contacts show.
    """

    def __init__(self, server: viser.ViserServer, content: Content, by: By) -> None:
        self._server, self._scene = server, server.scene
        self._content = content
        self.painter = Painter(by, content.contacts, content)
        self._instants: list[Instant] = []
        self._nodes: list[_Nodes] = []
        self._rods: dict[str, Any] = {}
        self._every = -(-len(content.contacts) // _MOST_ELLIPSOIDS)
        self._count, self._most = 0, 0
        self._lock = threading.RLock()
        self.shown = -1
        self._towards = _towards(content)
        self._still()
        self.refit(content.fitted)
        self.replace(content.instants)

    @property
    def instants(self) -> list[Instant]:
        """From first to last."""
        return self._instants

    @property
    def legend(self) -> str:
        """What the colours mean, in HTML."""
        surface = surface_legend(self.fitted, self._content.unit) if self.fitted else None
        return legend_html(self.painter.legend, self._instants, self._content.notes, surface)

    @property
    def contacts(self) -> Rows:
        """Those of all instants."""
        return Rows.joined([Rows.none(), *(instant.contacts for instant in self._instants)])

    def replace(self, instants: Sequence[Instant]) -> None:
        """Show these instants instead of those so far, the last one first."""
        with self._lock, self._server.atomic():
            for name in ("/rods", "/contacts", "/ellipsoids"):
                if self._instants and self._scene.get_handle_by_name(name) is not None:
                    self._scene.remove_by_name(name)
            self._instants, self._nodes, self._rods, self._count = [], [], {}, 0
            for name in ("/rods", "/contacts", "/ellipsoids"):
                self._scene.add_frame(name, show_axes=False)
            pieces = [sum(map(len, instant.rods.values())) for instant in instants]
            self._most = max([0, *pieces])
            for instant in instants:
                self.append(instant)
            self.show(len(self._instants) - 1)

    def refit(self, fitted: Sequence[Fitted]) -> None:
        """Show these fitted surfaces instead of those so far."""
        self.fitted = tuple(fitted)
        if not self.fitted:
            return
        legend = surface_legend(self.fitted, self._content.unit)
        assert legend.scale is not None
        self._fade_object()
        outliers = np.concatenate([one.outlier for one in self.fitted])
        with self._lock, self._server.atomic():
            for number, one in enumerate(self.fitted):
                self._scene.add_mesh_trimesh(f"/surface/{number}", coloured(one, legend.scale))
            if self._scene.get_handle_by_name("/surface/outliers") is not None:
                self._scene.remove_by_name("/surface/outliers")
            if len(outliers):
                self._scene.add_point_cloud(
                    "/surface/outliers",
                    outliers,
                    rgb(OUTLIER),
                    point_size=2 * _POINT * self._content.size,
                    point_shape="circle",
                    precision="float32",
                )

    def _fade_object(self) -> None:
        """Show the object as the inside of a faint shell: where a fitted surface coincides with
        it, a browser would draw patches of both.
        """
        handle: Any = self._scene.get_handle_by_name("/object")
        if handle is not None:
            handle.side, handle.opacity = "back", _SHELL

    def _still(self) -> None:
        """What does not change: object, trails, frames, axes, camera."""
        content, scene = self._content, self._scene
        low, high = rounded(*content.box)
        span = float(np.linalg.norm(high - low)) or content.size
        center = (low + high) / 2
        camera = self._server.initial_camera
        camera.look_at, camera.fov = center, _FIELD
        camera.position = center + 0.62 * span / np.tan(_FIELD / 2) * self._towards
        camera.near, camera.far = 1e-3 * span, 1e2 * span
        scene.configure_default_lights(cast_shadow=False)
        # Rods often come from below, where the default lights leave an object dark.
        scene.add_light_ambient("/light", intensity=0.4)
        if len(content.triangles):
            vertices, faces = smoothed(content.triangles)
            scene.add_mesh_simple("/object", vertices, faces, color=_PAINT, side="double")
        scene.add_frame("/surface", show_axes=False)
        for number, trail in enumerate(content.trails):
            pieces = np.stack([trail[:-1], trail[1:]], axis=1)
            if len(pieces):
                scene.add_line_segments(
                    f"/trails/{number}", pieces, _TRAIL, thickness=1.0, thickness_units="screen"
                )
        for pose in content.poses:
            scene.add_frame(
                f"/frames/{pose.name}",
                axes_length=content.size / 5,
                axes_radius=content.size / 250,
                position=pose.position,
                wxyz=pose.orientation[[3, 0, 1, 2]],
            )
            scene.add_label(f"/frames/{pose.name}/name", pose.name)
        self.draw_axes(low, high)

    def draw_axes(self, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> None:
        """Axes with their unit around a box, in place of those there."""
        lines, labels = ticked_box(low, high, self._content.unit, self._towards)
        self._scene.remove_by_name("/axes") if self._scene.get_handle_by_name("/axes") else None
        self._scene.add_frame("/axes", show_axes=False)
        self._scene.add_line_segments(
            "/axes/lines", lines, _AXIS, thickness=1.0, thickness_units="screen"
        )
        for number, (place, text) in enumerate(labels):
            self._scene.add_label(
                f"/axes/{number}", text, position=place, anchor="center-center", depth_test=True
            )

    def append(self, instant: Instant) -> None:
        """Add an instant, the newest, and its contacts; `show` shows its rods."""
        with self._lock:
            for colour, pieces in instant.rods.items():
                if colour not in self._rods and len(pieces):
                    self._rods[colour] = self._scene.add_line_segments(
                        f"/rods/{len(self._rods)}",
                        self._padded(pieces),
                        rgb(colour),
                        thickness=_LINE,
                        thickness_units="screen",
                        visible=False,
                    )
            nodes = self._contact_nodes(len(self._instants), instant.contacts)
            self._instants.append(instant)
            self._nodes.append(nodes)

    def _padded(self, pieces: Float[np.ndarray, "n 2 3"]) -> Float[np.ndarray, "most 2 3"]:
        """As many pieces as a colour ever has, so that the browser's buffers keep their size; spare
        ones are points of the first.
        """
        spare = np.broadcast_to(pieces[:1, :1], (max(self._most - len(pieces), 0), 2, 3))
        return np.concatenate([pieces, spare]).astype(np.float32)

    def _contact_nodes(self, number: int, rows: Rows) -> _Nodes:
        if not len(rows):
            return _Nodes(None, None)
        points = self._scene.add_point_cloud(
            f"/contacts/{number}",
            rows.point,
            self.painter(rows),
            point_size=_POINT * self._content.size,
            point_shape="circle",
            precision="float32",
        )
        first = -self._count % max(self._every, 1)
        self._count += len(rows)
        return _Nodes(points, self._ellipsoids(number, rows[first :: max(self._every, 1)]))

    def _ellipsoids(self, number: int, rows: Rows) -> Any:
        size = self._content.size
        rows = rows[np.isfinite(rows.covariance).all(axis=(1, 2))]
        axes = half_axes(rows.covariance)
        half = np.linalg.norm(axes, axis=1)
        shown = half[:, -1] < _HIDING * size
        rows, axes, half = rows[shown], axes[shown], half[shown]
        if not len(rows):
            return None
        ball, faces = unit_ball()
        return self._scene.add_batched_meshes_simple(
            f"/ellipsoids/{number}",
            ball,
            faces,
            batched_wxyzs=_turns(axes),
            batched_positions=rows.point,
            # A length of zero would leave no normal to shade by.
            batched_scales=np.maximum(half, 1e-4 * size),
            batched_colors=_UNCERTAIN,
            batched_opacities=np.where(half[:, -1] > WIDE * size, 0.05, 0.3),
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

    def show(self, number: int) -> None:
        """Show the rods of an instant, and the contacts up to it."""
        with self._lock, self._server.atomic():
            if not self._instants:
                return
            rods = self._instants[number].rods
            for colour, node in self._rods.items():
                pieces = rods.get(colour, _NO_PIECES)
                node.visible = len(pieces) > 0
                if len(pieces):
                    node.points = self._padded(pieces)
            for other, nodes in enumerate(self._nodes):
                for node in nodes:
                    if node is not None:
                        node.visible = other <= number
            self.shown = number

    def recolour(self, by: By) -> None:
        """Let the colours of contacts show something else, over the range of those there."""
        with self._lock, self._server.atomic():
            self.painter = Painter(by, self.contacts, self._content)
            for instant, nodes in zip(self._instants, self._nodes, strict=True):
                if nodes.points is not None:
                    nodes.points.colors = self.painter(instant.contacts)

    def picked(
        self, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
    ) -> Rows | None:
        """The contact nearest to the eye among those shown that a ray meets, or None."""
        with self._lock:
            parts = [instant.contacts for instant in self._instants[: self.shown + 1]]
        rows = Rows.joined([Rows.none(), *parts])
        along = (rows.point - origin) @ direction
        aside = np.linalg.norm(rows.point - origin - along[:, None] * direction, axis=1)
        near = np.flatnonzero((along > 0) & (aside < _PICK * along))
        if not len(near):
            return None
        return rows[near[[np.argmin(along[near])]]]

    def mark(self, rows: Rows | None) -> None:
        """Mark a contact, with its normal, in place of the one marked before."""
        if self._scene.get_handle_by_name("/chosen") is not None:
            self._scene.remove_by_name("/chosen")
        if rows is None:
            return
        size = self._content.size
        self._scene.add_icosphere("/chosen", 0.02 * size, (255, 170, 0), position=rows.point[0])
        if np.isfinite(rows.normal).all():
            arrow = np.stack([np.zeros((1, 3)), 0.15 * size * rows.normal], axis=1)
            self._scene.add_arrows(
                "/chosen/normal",
                arrow,
                (42, 127, 63),
                shaft_radius=0.003 * size,
                head_radius=0.008 * size,
                head_length=0.025 * size,
            )


def smoothed(
    triangles: Float[np.ndarray, "f 3 3"],
) -> tuple[Float[np.ndarray, "v 3"], np.ndarray]:
    """Vertices and faces that share vertices except across edges, so that shading shows those."""
    import trimesh  # noqa: PLC0415

    count = 3 * len(triangles)
    mesh = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(count).reshape(-1, 3), process=True)
    parts = trimesh.graph.smooth_shade(mesh, angle=np.radians(30))
    return np.asarray(parts.vertices), np.asarray(parts.faces)


def coloured(fitted: Fitted, scale: Scale) -> Any:
    """A fitted surface as `trimesh.Trimesh`. Its colours are a texture: a browser takes those of
    vertices for linear in the light, so that they would differ from the legend's.
    """
    import trimesh  # noqa: PLC0415
    from PIL import Image  # noqa: PLC0415

    places = np.linspace(0, 1, _SHADES)
    shades = Image.fromarray(scale.colours(places)[None].round().astype(np.uint8))
    along = ((_SHADES - 1) * scale.place(fitted.deviation) + 0.5) / _SHADES
    visual: Any = trimesh.visual
    material = visual.material.PBRMaterial(
        baseColorTexture=shades, metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
    )
    return trimesh.Trimesh(
        fitted.vertices,
        fitted.faces,
        vertex_normals=fitted.normal,
        visual=visual.TextureVisuals(np.column_stack([along, 0 * along]), material=material),
        process=False,
    )


def unit_ball() -> tuple[Float[np.ndarray, "v 3"], np.ndarray]:
    """Vertices and faces of a ball of radius 1."""
    import trimesh  # noqa: PLC0415

    ball = trimesh.creation.icosphere(subdivisions=2)
    return np.asarray(ball.vertices), np.asarray(ball.faces)


def _turns(axes: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 4"]:
    """Rotations (w x y z) that take the coordinate axes to these, up to their sense."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415

    lengths = np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), np.finfo(float).tiny)
    turn = axes / lengths
    turn[..., 0] *= np.sign(np.linalg.det(turn))[:, None]
    return np.asarray(Rotation.from_matrix(turn).as_quat()[:, [3, 0, 1, 2]])


def _towards(content: Content) -> Float[np.ndarray, "3"]:
    """Direction towards the eye: in front, moved to the side from where the object is touched."""
    facing = content.contacts.normal
    facing = facing[np.isfinite(facing).all(axis=1)]
    if not len(facing):
        rods = [rod for instant in content.instants for rod in instant.rods.values() if len(rod)]
        ends = np.array([np.zeros(3), *(rod[0, 0] - rod[-1, 1] for rod in rods)])
        facing = ends / np.maximum(np.linalg.norm(ends, axis=1, keepdims=True), 1e-12)
    towards = np.array([0.45, -0.8, 0.25]) + np.array([2.0, 2.0, 0.4]) * facing.mean(axis=0)
    return np.asarray(towards / np.linalg.norm(towards))
