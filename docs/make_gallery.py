"""Draw the gallery: `uv run --group gallery --extra mesh python docs/make_gallery.py [NAME ...]`
writes one picture for each kind of object into docs/images/gallery.

An object is drawn by its own faces where it has edges, else as the zero of its level function
within a box, by marching cubes; parts of the rods behind it are found by the same function, and
drawn faintly.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")

import jax.numpy as jnp
import numpy as np
import trimesh
from contourpy import contour_generator
from jax import Array
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D, proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from PIL import Image, ImageChops
from skimage.measure import marching_cubes

import vibrissa as vb
from vibrissa.plot import journal, save_as
from vibrissa.plot.lines import dress
from vibrissa.plot.style import COLUMN, KIND_COLOURS, KIND_NAMES, length_factor

IMAGES = Path(__file__).parent / "images" / "gallery"
CASES = Path(__file__).parents[1] / "examples" / "cases"
UNIT = vb.Rod.unit()
WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)

_CELLS = 90
_PAINT = np.array([0.84, 0.87, 0.90])
_SAMPLES = 90
_STRAIGHT, _FREE = "black", "0.6"
_FORCE, _NORMAL = "#d97706", "#2a7f3f"
_ARROW = 0.2
_SECTIONS = 180


class Exhibit(NamedTuple):
    """What a picture shows: an object, drawn within a box (2, 3), and a rod swept along it, every
    so many positions; seen from (elevation, azimuth) [°].
    """

    surface: Callable[[], vb.surfaces.Surface]
    box: tuple[tuple[float, float, float], tuple[float, float, float]]
    trail: vb.Trail
    every: int = 12
    view: tuple[float, float] = (10.0, -55.0)
    rod: vb.Rod = UNIT
    finite_radius: bool = False
    friction: float = 0.0


def _raster(
    *sides: float, x: float = 0.95, count: int = 191, axis: tuple[float, float, float] = (0, 0, 1)
) -> vb.Trail:
    """Trails along −x at these y."""
    return vb.Trail.stack(
        [vb.Trail.line(start=(x, y, 0), stop=(-x, y, 0), count=count, axis=axis) for y in sides]
    )


def _whisks() -> vb.Trail:
    """Three clamps beside each other that turn towards a wall."""
    motion = {"axis": (0, -1, 0), "start_angle": -0.2, "stop_angle": 1.2, "count": 141}
    return vb.Trail.stack([
        vb.Trail.whisk(pivot=(0, y, 0), position=(0, y, 0.01), rod_axis=(0, 20 * y, 1), **motion)
        for y in (-0.01, 0.0, 0.01)
    ])  # fmt: skip


def _two_drops(point: Array) -> Array:
    """Two balls that melt into one: a smooth least of their distances."""
    distances = [
        jnp.sqrt(jnp.sum((point - jnp.array(center)) ** 2)) - 0.32
        for center in ((-0.28, -0.05, 1.05), (0.33, 0.1, 1.2))
    ]
    return -0.12 * jnp.logaddexp(*(-distance / 0.12 for distance in distances))


def _mug() -> Exhibit:
    """The case of the mug, which is a mesh."""
    case = vb.load_case(CASES / "mug.toml")
    return Exhibit(
        lambda: case.surface,
        ((-0.023, -0.001, 0.034), (0.039, 0.045, 0.08)),
        case.trail,
        6,
        (20, -125),
        case.rod,
    )


def exhibits(names: list[str]) -> dict[str, Exhibit]:
    """Pictures with these names, or all."""
    s = vb.surfaces
    center, turn = (0.0, 0.0, 1.15), (0.1, -0.2, 0.15, 1.0)
    skew = (0.3, 1, 0.2)
    around, near = ((-0.8, -0.8, 0.4), (0.8, 0.8, 1.9)), ((-0.04, -0.04, 0.02), (0.04, 0.04, 0.1))
    wires = vb.Trail.raster(
        start=(0.045, -0.011, 0), stop=(-0.045, -0.011, 0), count=241, step=(0, 0.013, 0), trails=3
    )
    every = {
        "elliptic_paraboloid": Exhibit(
            lambda: s.EllipticParaboloid(a=0.5, b=1.0, h=0.4),
            ((-1.1, -0.8, 0.3), (1.1, 0.8, 1.05)),
            _raster(-0.4, -0.2, 0.2, 0.4, x=1.2),
            view=(5, -55),
        ),
        "sphere": Exhibit(
            lambda: s.Sphere(center=(0, 0, 0.0575), radius=0.03),
            ((-0.032, -0.032, 0.025), (0.032, 0.032, 0.09)),
            vb.Trail.raster(
                start=(0.04, -0.015, 0),
                stop=(-0.04, -0.015, 0),
                count=241,
                step=(0, 0.01, 0),
                trails=4,
            ),
            rod=WIRE,
        ),
        "ellipsoid": Exhibit(
            lambda: s.Ellipsoid(center=(0, 0, 0), semi_axes=(0.7, 0.45, 0.5)).placed(turn, center),
            around,
            _raster(-0.2, 0.15, 0.3),
        ),
        "elliptic_cylinder": Exhibit(
            lambda: s.EllipticCylinder(center=center, semi_axes=(0.6, 0.5)).placed((0, 0, 0.2, 1)),
            ((-0.9, -0.3, 0.6), (0.9, 0.8, 1.7)),
            _raster(-0.2, 0.2),
            view=(10, -40),
        ),
        "plane": Exhibit(
            lambda: s.Plane(point=(-0.01, 0, 0.05), normal=(1, 0.2, -1)),
            ((-0.045, -0.025, 0.02), (0.02, 0.025, 0.07)),
            vb.Trail.raster(
                start=(0.04, -0.015, 0),
                stop=(-0.035, -0.015, 0),
                count=241,
                step=(0, 0.015, 0),
                trails=3,
            ),
            rod=WIRE,
        ),
        "height_field": Exhibit(
            lambda: s.HeightField(
                lambda x, y: 0.5 * x**2 + y**2 + 0.45 + 0.015 * jnp.sin(8 * x) * jnp.cos(6 * y)
            ),
            ((-1.1, -0.75, 0.3), (1.1, 0.75, 1.05)),
            _raster(-0.3, 0.15, 0.35, x=1.2),
        ),
        "implicit": Exhibit(lambda: s.Implicit(_two_drops), around, _raster(-0.2, 0.1, 0.3)),
        "box": Exhibit(
            lambda: s.Box(center=(0, 0, 0), half_extents=(0.022, 0.018, 0.015)).placed(
                (0.25, -0.1, 0.3, 1.0), (0, 0, 0.057)
            ),
            near,
            wires,
            rod=WIRE,
            finite_radius=True,
        ),
        "cylinder": Exhibit(
            lambda: s.Cylinder(center=(0, 0, 0.058), axis=skew, radius=0.02, length=0.05),
            near,
            wires,
            rod=WIRE,
            finite_radius=True,
        ),
        "capsule": Exhibit(
            lambda: s.Capsule(center=center, axis=skew, radius=0.35, length=0.6),
            around,
            _raster(-0.2, 0.15, 0.35),
        ),
        "cone": Exhibit(
            lambda: s.Cone(center=(0.005, 0, 0.08), axis=(0.1, 0.1, -1), radius=0.03, height=0.055),
            near,
            wires,
            rod=WIRE,
            finite_radius=True,
        ),
        "superquadric": Exhibit(
            lambda: s.Superquadric(center=center, semi_axes=(0.6, 0.5, 0.5), exponents=(0.5, 0.5)),
            around,
            _raster(-0.3, 0.1, 0.35),
        ),
        "torus": Exhibit(
            lambda: s.Torus(
                center=(0, 0, 1.0), axis=(0.2, 0.3, 1), major_radius=0.5, minor_radius=0.2
            ),
            around,
            _raster(-0.35, 0.1, 0.45),
        ),
        "union": Exhibit(
            lambda: s.Union(
                [
                    s.Sphere(center=(-0.3, 0, 1.15), radius=0.45),
                    s.Sphere(center=(0.35, 0.1, 1.1), radius=0.35),
                ]
            ),
            around,
            _raster(-0.2, 0.2, 0.35),
        ),
        "whisking": Exhibit(
            lambda: s.Plane(point=(-0.028, 0, 0), normal=(1, 0.3, 0.1)),
            ((-0.05, -0.03, 0), (-0.01, 0.03, 0.07)),
            _whisks(),
            10,
            (22, -35),
            rod=WIRE,
        ),
        "friction": Exhibit(
            lambda: s.Sphere(center=(0, 0, 0.0575), radius=0.03),
            ((-0.032, -0.032, 0.025), (0.032, 0.032, 0.09)),
            vb.Trail.raster(
                start=(0.04, -0.012, 0),
                stop=(-0.04, -0.012, 0),
                count=241,
                step=(0, 0.02, 0),
                trails=2,
            ),
            rod=WIRE,
            every=16,
            friction=0.25,
        ),
    }
    chosen = {name: exhibit for name, exhibit in every.items() if not names or name in names}
    # Only where it is wanted: the mesh takes its time to be read.
    return chosen | ({"mesh": _mug()} if not names or "mesh" in names else {})


def picture(exhibit: Exhibit) -> tuple[Axes3D, vb.Scan]:
    """The object, elastic lines red in tip contact, blue in tangential contact and black where
    straight, and all contact points.
    """
    surface, factor = exhibit.surface(), length_factor(exhibit.rod)
    scan = vb.scan(
        exhibit.rod,
        surface,
        exhibit.trail,
        friction=exhibit.friction,
        finite_radius=exhibit.finite_radius,
    )
    figure = plt.figure(figsize=(1.7 * COLUMN, 1.25 * COLUMN))
    axes: Axes3D = figure.add_subplot(projection="3d", computed_zorder=False)
    axes.set_proj_type("ortho")
    elevation, azimuth = np.radians(exhibit.view)
    towards = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    corners = _draw_object(axes, surface, exhibit, towards)
    lines = _draw_rods(axes, scan, surface, exhibit, towards)
    everything = np.vstack([corners, lines, factor * scan.trail.position.reshape(-1, 3)])
    handles = [
        Line2D([], [], color=colour, label=KIND_NAMES[kind])
        for kind, colour in KIND_COLOURS.items()
        if np.any(scan.kind == kind)
    ]
    handles.append(Line2D([], [], color=_STRAIGHT, linewidth=0.6, label="straight part"))
    handles.append(Line2D([], [], color=_FREE, linewidth=0.6, label="without contact"))
    handles.append(
        Line2D(
            [], [], color="0.2", marker=".", linestyle="none", markersize=4, label="contact point"
        )
    )
    if exhibit.friction > 0:
        _draw_forces(axes, scan, surface, exhibit, towards)
        handles += [
            Line2D([], [], color=colour, label=label)
            for colour, label in ((_FORCE, "force on the rod"), (_NORMAL, "normal"))
        ]
    low, high = everything.min(axis=0), everything.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    dress(axes, scan)
    axes.view_init(*exhibit.view)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=3))
    axes.legend(
        handles=handles,
        loc="lower center",
        bbox_to_anchor=(0.5, _top(axes) + 0.02),
        ncols=2,
        handlelength=1.4,
        columnspacing=1.4,
    )
    return axes, scan


def _top(axes: Axes3D) -> float:
    """Height of the highest corner of the drawn box, as a share of the axes'."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.canvas.draw()
    corners = np.array(np.meshgrid(axes.get_xlim(), axes.get_ylim(), axes.get_zlim())).reshape(
        3, -1
    )
    across, up, _ = proj3d.proj_transform(*corners, axes.get_proj())
    shown = axes.transAxes.inverted().transform(
        axes.transData.transform(np.column_stack([across, up]))
    )
    return float(shown[:, 1].max())


def _draw_object(
    axes: Axes3D, surface: vb.surfaces.Surface, exhibit: Exhibit, towards: np.ndarray
) -> np.ndarray:
    """The object, shaded; returns all corners. Without faces of its own: the part within the box,
    and what the box's faces cut.
    """
    own = _faces(surface)
    if own is not None:
        facing = own.face_normals @ towards > 0
        triangles = length_factor(exhibit.rod) * own.triangles[facing]
        _paint(
            axes, list(triangles), surface.normal(own.triangles_center[facing]), towards, order=1
        )
        return triangles.reshape(-1, 3)
    low, high = np.array(exhibit.box)
    counts = np.maximum(np.ceil(_CELLS * (high - low) / (high - low).max()).astype(int), 2) + 1
    ticks = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    levels = surface.levels(np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1))
    corners, faces, _, _ = marching_cubes(levels, 0.0, spacing=tuple((high - low) / (counts - 1)))
    triangles, factor = (low + corners)[faces], length_factor(exhibit.rod)
    _paint(axes, list(factor * triangles), surface.normal(triangles.mean(axis=1)), towards, order=1)
    drawn = [factor * triangles.reshape(-1, 3)]
    for axis in range(3):
        # Of two opposite faces the one towards the eye: nothing of the solid is in front of it.
        end = -1 if towards[axis] > 0 else 0
        first, second = (other for other in range(3) if other != axis)
        cut = contour_generator(
            ticks[first], ticks[second], np.take(levels, end, axis=axis).T, fill_type="OuterOffset"
        )
        pieces = []
        for points, offsets in zip(*cut.filled(-np.inf, 0.0), strict=True):
            piece = np.full((offsets[1], 3), ticks[axis][end])
            piece[:, [first, second]] = points[: offsets[1]]
            pieces.append(factor * piece)
        _paint(axes, pieces, np.tile(np.eye(3)[axis], (len(pieces), 1)), towards, order=1.5)
        drawn += pieces
    return np.vstack(drawn)


def _faces(surface: vb.surfaces.Surface) -> trimesh.Trimesh | None:
    """Triangles of an object that a grid would blur: of a mesh, or with edges."""
    s, create = vb.surfaces, trimesh.creation
    match surface:
        case s.Placed():
            inner, motion = _faces(surface.surface), np.eye(4)
            motion[:3, :3], motion[:3, 3] = surface.rotation, surface.translation
            return None if inner is None else inner.apply_transform(motion)
        case s.Mesh():
            return trimesh.Trimesh(surface.vertices, surface.faces, process=False)
        case s.Box():
            return create.box(2 * np.asarray(surface.half_extents)).apply_translation(
                surface.center
            )
        case s.Cylinder():
            return _upon(
                surface,
                create.cylinder(float(surface.radius), float(surface.length), sections=_SECTIONS),
            )
        case s.Cone():
            return _upon(
                surface,
                create.cone(float(surface.radius), float(surface.height), sections=_SECTIONS),
            )
        case _:
            return None


def _upon(
    solid: vb.surfaces.Cylinder | vb.surfaces.Cone, upright: trimesh.Trimesh
) -> trimesh.Trimesh:
    """A mesh about +z, turned to the solid's axis and moved to its centre."""
    return upright.apply_transform(
        trimesh.geometry.align_vectors((0, 0, 1), solid.axis)
    ).apply_translation(solid.center)


def _paint(
    axes: Axes3D, polygons: list[np.ndarray], normals: np.ndarray, towards: np.ndarray, order: float
) -> None:
    if not polygons:
        return
    upwards = np.array([0, 0, 1]) - towards[2] * towards
    light = towards + (0.6 * upwards - 0.3 * np.cross(upwards, towards)) / np.linalg.norm(upwards)
    brightness = np.abs(normals @ light) / np.linalg.norm(light)
    colours = np.clip(_PAINT * (0.55 + 0.5 * brightness[:, None]), 0, 1)
    axes.add_collection3d(
        Poly3DCollection(
            polygons,
            facecolors=colours,
            edgecolors=colours,
            linewidths=0.25,
            zorder=order,
            clip_on=False,
        )
    )


def _draw_rods(
    axes: Axes3D, scan: vb.Scan, surface: vb.surfaces.Surface, exhibit: Exhibit, towards: np.ndarray
) -> np.ndarray:
    """Trails, rods and contact points; returns the points of the rods."""
    factor, rod = length_factor(exhibit.rod), exhibit.rod
    pieces, colours, widths = [], [], []
    for lane in range(len(scan.kind)):
        axes.plot(*(factor * scan.trail.position[lane]).T, color="0.6", linewidth=0.6, zorder=0)
        for index in range(0, scan.trail.count, exhibit.every):
            if not scan.solved[lane, index]:
                continue
            line = scan.elastic_line((lane, index), _SAMPLES)
            kind = vb.ContactKind(int(scan.kind[lane, index]))
            bent = np.linspace(0, rod.length, _SAMPLES)[:-1] < np.nan_to_num(
                scan.arc_length[lane, index]
            )
            pieces.append(np.stack([line[:-1], line[1:]], axis=1))
            colours.append(
                np.where(
                    bent,
                    KIND_COLOURS.get(kind, _FREE),
                    _STRAIGHT if scan.in_contact[lane, index] else _FREE,
                )
            )
            widths.append(np.where(bent, 0.8, 0.5))
    segments, colour, width = (
        np.concatenate(pieces),
        np.concatenate(colours),
        np.concatenate(widths),
    )
    seen = _seen(segments.mean(axis=1), surface, exhibit, towards)
    for part, alpha, order in ((~seen, 0.22, 2), (seen, 1.0, 3)):
        if not part.any():
            continue
        axes.add_collection3d(
            Line3DCollection(
                factor * segments[part],
                colors=colour[part],
                linewidths=width[part],
                alpha=alpha,
                zorder=order,
                capstyle="round",
                clip_on=False,
            )
        )
    for kind, paint in KIND_COLOURS.items():
        points = scan.point[scan.kind == kind]
        points = points[_seen(points, surface, exhibit, towards)] if len(points) else points
        axes.plot(
            *(factor * points).T,
            linestyle="none",
            marker=".",
            markersize=1.6,
            markeredgewidth=0,
            color=np.array(mpl.colors.to_rgb(paint)) * 0.6,
            zorder=4,
        )
    return factor * segments.reshape(-1, 3)


def _draw_forces(
    axes: Axes3D, scan: vb.Scan, surface: vb.surfaces.Surface, exhibit: Exhibit, towards: np.ndarray
) -> None:
    """Directions of the contact force and of the normal, at the rods that are drawn."""
    rows = np.zeros(scan.kind.shape, dtype=bool)
    rows[:, :: exhibit.every] = True
    rows &= scan.in_contact
    rows[rows] = _seen(scan.point[rows], surface, exhibit, towards)
    for directions, colour in ((scan.normal, _NORMAL), (scan.force_direction, _FORCE)):
        ends = scan.point[rows] + _ARROW * exhibit.rod.length * directions[rows]
        arrows = length_factor(exhibit.rod) * np.stack([scan.point[rows], ends], axis=1)
        axes.add_collection3d(
            Line3DCollection(arrows, colors=colour, linewidths=0.9, zorder=5, clip_on=False)
        )


def _seen(
    points: np.ndarray, surface: vb.surfaces.Surface, exhibit: Exhibit, towards: np.ndarray
) -> np.ndarray:
    """Whether nothing of the object, as far as it is drawn, lies between the points (n, 3) and the
    eye.
    """
    low, high = np.array(exhibit.box)
    reach = np.linspace(0.012, 2.5, 250) * max(exhibit.rod.length, np.linalg.norm(high - low) / 2.5)
    way = points[:, None] + reach[:, None] * towards
    drawn = np.all((way > low) & (way < high), axis=-1)
    hidden = np.zeros(drawn.shape, dtype=bool)
    hidden[drawn] = surface.levels(way[drawn]) < 0
    return ~hidden.any(axis=1)


def _trimmed(path: Path) -> Path:
    """Cut the picture's white margins off: the box of a figure in space reaches beyond what it
    shows.
    """
    with Image.open(path) as image:
        opaque = image.convert("RGB")
    left, top, right, bottom = ImageChops.invert(opaque).getbbox() or (0, 0, *opaque.size)
    margin = 12
    canvas = Image.new("RGB", (right - left + 2 * margin, bottom - top + 2 * margin), "white")
    canvas.paste(opaque.crop((left, top, right, bottom)), (margin, margin))
    # Without k-means the few pixels of a thin line would lose their colour.
    canvas.quantize(256, kmeans=4).save(path, optimize=True)
    return path


def main(names: list[str]) -> list[Path]:
    """Draw the pictures with these names, or all; return their paths."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, exhibit in exhibits(names).items():
        with journal():
            mpl.rcParams["savefig.dpi"] = 180
            axes, scan = picture(exhibit)
            paths.append(_trimmed(save_as(axes, IMAGES / f"{name}.png")))
        kinds = ", ".join(
            f"{kind.name} {int(np.sum(scan.kind == kind))}" for kind in vb.ContactKind
        )
        status = ", ".join(
            f"{vb.Status(int(code)).name} {count}"
            for code, count in zip(*np.unique(scan.status, return_counts=True), strict=True)
        )
        print(f"{paths[-1].name}: {kinds}; {status}", flush=True)  # noqa: T201
    return paths


if __name__ == "__main__":
    main(sys.argv[1:])
