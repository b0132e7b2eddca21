"""Draw the gallery: `uv run python docs/make_gallery.py [NAME ...]` writes one picture for each
kind of object, and one of a surface fitted to what was felt, into docs/images/gallery.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")

import jax.numpy as jnp
import numpy as np
from jax import Array
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from PIL import Image
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.drawing import KIND_COLOURS
from vibrissa.plot import journal, save_as

IMAGES = Path(__file__).parent / "images" / "gallery"
CASES = Path(__file__).parents[1] / "examples" / "cases"
UNIT = vb.Rod.unit()
WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)


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


def _case(
    name: str,
    box: tuple[tuple[float, float, float], tuple[float, float, float]],
    every: int,
    view: tuple[float, float],
) -> Exhibit:
    """A case of the examples."""
    case = vb.load_case(CASES / f"{name}.toml")
    return Exhibit(lambda: case.surface, box, case.trail, every, view, case.rod)


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
    every |= {
        "rat_whisker": _case(
            "rat_whisker", ((-0.022, -0.022, 0.03), (0.022, 0.022, 0.075)), 10, (8, -65)
        ),
        "wire_in_wind": _case(
            "wire_in_wind", ((-0.032, -0.032, -0.142), (0.032, 0.032, -0.078)), 10, (12, -70)
        ),
        "follicle": _case("follicle", ((-0.03, -0.02, 0.0), (-0.006, 0.02, 0.04)), 7, (20, -48)),
    }
    chosen = {name: exhibit for name, exhibit in every.items() if not names or name in names}
    # Only where it is wanted: the mesh takes its time to be read.
    return chosen | ({"mesh": _mug()} if not names or "mesh" in names else {})


def picture(exhibit: Exhibit) -> tuple[Axes3D, vb.Scan]:
    """The exhibit, scanned and drawn."""
    scan = vb.scan(
        exhibit.rod,
        exhibit.surface(),
        exhibit.trail,
        friction=exhibit.friction,
        finite_radius=exhibit.finite_radius,
    )
    axes = vb.plot.scene(
        scan,
        rods=exhibit.trail.count // exhibit.every,
        directions=exhibit.friction > 0,
        events=False,
        box=exhibit.box,
        view=exhibit.view,
    )
    return axes, scan


def touch_to_shape() -> tuple[Axes3D, vb.Shape]:
    """A wire with a noisy sensor sweeps over three sides of a rounded block; the surface through
    its contacts, and some of its elastic lines.
    """
    block = vb.surfaces.Offset(
        vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.017, 0.014, 0.012)), 0.003
    )
    sensor = vb.Sensor(
        np.array([0.0, 0.0, 0.025]),
        np.array([0.0, 0.0, 0.0, 1.0]),
        "on_sensor",
        tare_seconds=0.95,
        force_noise=2e-3,
        torque_noise=4e-5,
        position_noise=1e-5,
    )
    arm = vb.SimulatedArm(WIRE, block, sensor, rate=50.0, rng=np.random.default_rng(0))
    found = []
    for axis, angle in (("x", -90), ("x", 180), ("y", -90)):  # from −y, from above, from +x
        side = Rotation.from_euler(axis, angle, degrees=True)
        for offset in (-0.012, -0.006, 0.0, 0.006, 0.012):
            ends = side.apply([[0.04, offset, -0.05], [-0.04, offset, -0.05]])
            found.append(arm(vb.Trail(ends, np.tile(side.as_quat(), (2, 1)))))
    shape = vb.fit_shape([each.contacts for each in found])
    axes = vb.plot.shape_figure(shape.mesh())
    lines = [_draw_lines(axes, each) for each in found[::4]]
    _hold(axes, np.vstack([*lines, 1e3 * shape.sites.point]))
    return axes, shape


def _draw_lines(axes: Axes3D, found: vb.Reconstruction) -> np.ndarray:
    """Every eighth elastic line of a sweep, coloured by the kind of contact; its points [mm]."""
    rows = np.flatnonzero(found.in_contact & (found.status == vb.Status.OK))[::8]
    lines = 1e3 * found.elastic_lines(rows, 40)
    colours = [KIND_COLOURS[vb.ContactKind(int(kind))] for kind in found.kind[rows]]
    axes.add_collection3d(Line3DCollection(lines, colors=colours, linewidths=0.6))
    return lines.reshape(-1, 3)


def _hold(axes: Axes3D, points: np.ndarray) -> None:
    """Set limits around points, at equal scales."""
    low, high = points.min(axis=0) - 2, points.max(axis=0) + 2
    axes.set(**{f"{name}lim": ends for name, *ends in zip("xyz", low, high, strict=True)})
    axes.set_box_aspect(high - low)


def _small(path: Path) -> Path:
    """Keep 256 colours; without k-means the few pixels of a thin line would lose theirs."""
    with Image.open(path) as image:
        image.convert("RGB").quantize(256, kmeans=4).save(path, optimize=True)
    return path


def main(names: list[str]) -> list[Path]:
    """Draw the pictures with these names, or all; return their paths."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, exhibit in exhibits(names).items():
        with journal():
            mpl.rcParams["savefig.dpi"] = 180
            axes, scan = picture(exhibit)
            paths.append(_small(save_as(axes, IMAGES / f"{name}.png")))
        kinds = ", ".join(
            f"{kind.name} {int(np.sum(scan.kind == kind))}" for kind in vb.ContactKind
        )
        status = ", ".join(
            f"{vb.Status(int(code)).name} {count}"
            for code, count in zip(*np.unique(scan.status, return_counts=True), strict=True)
        )
        print(f"{paths[-1].name}: {kinds}; {status}", flush=True)  # noqa: T201
    if not names or "touch_to_shape" in names:
        with journal():
            mpl.rcParams["savefig.dpi"] = 180
            axes, shape = touch_to_shape()
            paths.append(_small(save_as(axes, IMAGES / "touch_to_shape.png")))
        print(f"{paths[-1].name}: {shape}", flush=True)  # noqa: T201
    return paths


if __name__ == "__main__":
    main(sys.argv[1:])
