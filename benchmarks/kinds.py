"""Speed of `vb.scan` by kind of object, on one core: `python benchmarks/kinds.py [NAME ...]`.

Every trail of an object runs from just before its first contact to where the rod leaves the object,
or to the first hard event: a snap or a change of lateral stability, which is followed individually
and costs about 30 ms wherever it occurs. So nearly all positions are in contact, and marched.
Meshes are left out if their libraries are not installed; the time of the first call does not
include building a mesh.
"""

import sys
from collections.abc import Callable
from importlib.util import find_spec
from time import perf_counter
from typing import NamedTuple

from timing import best_of, pin_to_one_core

if __name__ == "__main__":
    pin_to_one_core()

import jax.numpy as jnp
import numpy as np

import vibrissa as vb

ROD = vb.Rod.unit()
TRAILS, POSITIONS = 100, 201
HARD = (vb.EventKind.SNAP, vb.EventKind.LATERAL_INSTABILITY, vb.EventKind.LATERAL_RECOVERY)
_CENTER, _TURN = (0.0, 0.0, 1.15), (0.1, -0.2, 0.15, 1.0)


class Figures(NamedTuple):
    """Figures of one object: seconds for the first call; microseconds per position in a batch and
    on one trail; share of positions in contact and in tangential contact.
    """

    first: float
    batch: float
    single: float
    contact: float
    tangential: float


def objects() -> dict[str, Callable[[], vb.surfaces.Surface]]:
    """Builders of the objects that this version has, all about the size of the rod's length."""
    s = vb.surfaces
    axes = np.array([0.7, 0.5, 0.6])
    every = {
        "EllipticParaboloid": lambda: s.EllipticParaboloid(a=0.5, b=1.0, h=0.4),
        "Sphere": lambda: s.Sphere(center=_CENTER, radius=0.6),
        "Ellipsoid": lambda: s.Ellipsoid(center=_CENTER, semi_axes=axes),
        "Ellipsoid, placed": lambda: s.Ellipsoid(center=(0, 0, 0), semi_axes=axes).placed(
            _TURN, _CENTER
        ),
        "Plane": lambda: s.Plane(point=(-0.6, 0, 0), normal=(1.0, 0.3, -0.3)),
        "EllipticCylinder, placed": lambda: s.EllipticCylinder(
            center=(0, 0, 0), semi_axes=(0.6, 0.5)
        ).placed((0.25, 0, 0.1, 1), _CENTER),
        "HeightField, a paraboloid": lambda: s.HeightField(lambda x, y: 0.5 * x**2 + y**2 + 0.4),
        "HeightField, waves": lambda: s.HeightField(
            lambda x, y: 0.5 * x**2 + y**2 + 0.4 + 0.005 * jnp.sin(8 * x) * jnp.cos(6 * y)
        ),
        "Implicit, a sphere": lambda: s.Implicit(
            lambda p: jnp.sqrt(jnp.sum((p - jnp.array(_CENTER)) ** 2)) - 0.6
        ),
        "Box": lambda: s.Box(center=(0, 0, 0), half_extents=(0.5, 0.4, 0.4)).placed(_TURN, _CENTER),
        "Cylinder": lambda: s.Cylinder(center=_CENTER, axis=(0.3, 1, 0.2), radius=0.5, length=1.0),
        "Capsule": lambda: s.Capsule(center=_CENTER, axis=(0.3, 1, 0.2), radius=0.5, length=1.0),
        "Cone": lambda: s.Cone(center=(0.1, 0, 1.6), axis=(0.1, 0.1, -1), radius=0.6, height=1.2),
        "Superquadric": lambda: s.Superquadric(
            center=_CENTER, semi_axes=axes, exponents=(0.6, 0.6)
        ),
        "Torus": lambda: s.Torus(
            center=_CENTER, axis=(0.2, 0.3, 1), major_radius=0.5, minor_radius=0.2
        ),
        "Union": lambda: s.Union(
            [
                s.Sphere(center=(-0.3, 0, 1.15), radius=0.5),
                s.Sphere(center=(0.3, 0.1, 1.15), radius=0.5),
            ]
        ),
        "Mesh, 1280 faces": lambda: s.Mesh(*_ball_mesh(3)),
        "Mesh, 81920 faces": lambda: s.Mesh(*_ball_mesh(6)),
    }
    # Meshes need an extra.
    found = find_spec("igl") and find_spec("trimesh")
    return {name: build for name, build in every.items() if found or not name.startswith("Mesh")}


def figures(surface: vb.surfaces.Surface) -> Figures:
    """Measure one object."""
    start = perf_counter()
    batch = _in_contact(surface)
    first = perf_counter() - start
    single = vb.Trail(batch.position[TRAILS // 3], batch.orientation[TRAILS // 3])
    scan = vb.scan(ROD, surface, batch)
    return Figures(
        first,
        best_of(20, lambda: vb.scan(ROD, surface, batch), scan.kind.size),
        best_of(50, lambda: vb.scan(ROD, surface, single), single.count),
        float(np.mean(scan.in_contact)),
        float(np.mean(scan.kind == vb.ContactKind.TANGENTIAL)),
    )


def _in_contact(surface: vb.surfaces.Surface) -> vb.Trail:
    """Trails along −x, y = 0.1 to 0.35, each from just before its first contact to its end, or to
    just before the first hard event of a sweep.
    """
    x, y = np.linspace(1.4, -1.4, POSITIONS), np.linspace(0.1, 0.35, TRAILS)
    wide = np.zeros((TRAILS, POSITIONS, 3))
    wide[..., 0], wide[..., 1] = x, y[:, None]
    scan = vb.scan(ROD, surface, vb.Trail(wide))
    ends = POSITIONS - 1 - scan.in_contact[:, ::-1].argmax(axis=1)
    for event in reversed(scan.events):
        if event.kind in HARD or event.kind == vb.EventKind.DETACH:
            # Close to a fold steps are halved: stay clear of it.
            ends[event.trail] = int(event.parameter * (POSITIONS - 1)) - 4 * (event.kind in HARD)
    begins = np.maximum(scan.in_contact.argmax(axis=1) - 1, 0)
    # A trail that touches only briefly is replaced by another.
    rows = np.resize(np.flatnonzero(ends - begins > POSITIONS // 20), TRAILS)
    wide[..., 0] = np.linspace(x[begins[rows]], x[ends[rows]], POSITIONS).T
    wide[..., 1] = y[rows, None]
    return vb.Trail(wide)


def _ball_mesh(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a ball of radius 0.6 about the centre."""
    from trimesh.creation import icosphere  # noqa: PLC0415

    ball = icosphere(subdivisions=subdivisions, radius=0.6)
    return ball.vertices + _CENTER, ball.faces


def main(names: list[str]) -> dict[str, Figures]:
    """Print the table and return it; names select kinds by their beginning."""
    print(f"{TRAILS} trails x {POSITIONS} positions, and one of them; µs a position, one core\n")
    print(
        f"{'object':<30}{'first call, s':>14}{'batch':>10}{'ratio':>8}{'one trail':>12}{'in contact':>12}{'tangential':>12}"
    )
    found: dict[str, Figures] = {}
    for name, build in objects().items():
        if names and not any(name.startswith(chosen) for chosen in names):
            continue
        found[name] = row = figures(build())
        ratio = row.batch / next(iter(found.values())).batch
        print(
            f"{name:<30}{row.first:>14.1f}{row.batch:>10.2f}{ratio:>8.2f}{row.single:>12.1f}{row.contact:>12.0%}{row.tangential:>12.0%}",
            flush=True,
        )
    return found


if __name__ == "__main__":
    main(sys.argv[1:])
