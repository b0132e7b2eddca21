"""Surfaces through the same simulated contacts, by `vb.fit_shape` and two peers: `uv run --extra
mesh --group benchmark python -W ignore benchmarks/surfaces.py [NAME ...]`; each NAME selects the
objects whose names begin with it.

The peers, both of gpytoolbox, get the points and normals that `fit_shape` uses, scaled to a box of
unit size. Screened Poisson reconstruction (Kazhdan & Hoppe, TOG 2013) states no deviation.
Stochastic Poisson surface reconstruction (Sellán & Jacobson, TOG 2022) states the variance of a
level: that over the square of the mean's slope is the variance of the surface's place.
"""

import sys
from collections.abc import Callable
from typing import NamedTuple

from timing import best_of, pin_to_one_core
from touching import touched

if __name__ == "__main__":
    pin_to_one_core()

import gpytoolbox
import igl
import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import KDTree

import vibrissa as vb

OBJECTS: dict[str, vb.surfaces.Surface] = {
    "ellipsoid": vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.024, 0.019, 0.016)),
    "rounded block": vb.surfaces.Offset(
        vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.017, 0.014, 0.012)), 0.003
    ),
}
OFFSETS = 5e-3 * np.arange(-2, 3)
"""Of a side's five sweeps from its middle [m]."""
NEAR = 3e-3
"""Distance from a contact up to which a place counts as touched [m]."""
TREE, WEIGHT = 8, 4.0
"""Depth of the screened peer's octree and weight of its points. Depths from 5 to 10 and weights from
1 to 40 make the mean errors near contacts at best a tenth smaller, on either object.
"""
CELLS, MODES, MARGIN = 48, 300, 0.25
"""Nodes of the stochastic peer's grid along each axis, eigenfunctions of its variance, and what the
grid has beyond the contacts. On the ellipsoid, 64 nodes change the errors near contacts by 2 %.
"""
HALF_WIDTH = 1.96
"""Of a 95 % interval [standard deviation]."""


class Found(NamedTuple):
    """A surface at points of the truth."""

    away: np.ndarray
    """Distances (n,) [m]."""
    deviation: np.ndarray | None = None
    """As stated (n,) [m]."""


class Cloud(NamedTuple):
    """Points (n, 3) [unit] and normals (n, 3)."""

    point: np.ndarray
    normal: np.ndarray
    unit: float
    """[m]"""


Method = Callable[[], Callable[[np.ndarray], Found]]
"""Reconstructs; what it returns compares with the truth, which is not timed."""


def spread(surface: vb.surfaces.Surface, count: int = 2000) -> np.ndarray:
    """Points spread over an object, evenly but for its edges: (count, 3)."""
    points = 0.03 * np.random.default_rng(0).uniform(-1, 1, (40 * count, 3))
    points = points[np.abs(surface.distances(points)) < 0.5e-3]
    return surface.nearest(points)[:count]


def fitted(contacts: list[vb.Contacts]) -> Callable[[np.ndarray], Found]:
    """`vb.fit_shape`, with all that the contacts state about their errors."""
    shape = vb.fit_shape(contacts)
    return lambda truth: Found(np.abs(shape.distance(truth)), shape.deviation(truth))


def screened(cloud: Cloud) -> Callable[[np.ndarray], Found]:
    """Screened Poisson reconstruction: a mesh."""
    vertices, faces = gpytoolbox.point_cloud_to_mesh(
        cloud.point, cloud.normal, psr_screening_weight=WEIGHT, psr_depth=TREE
    )
    return lambda truth: Found(_from_mesh(cloud.unit * vertices, faces, truth))


def stochastic(cloud: Cloud) -> Callable[[np.ndarray], Found]:
    """Stochastic Poisson surface reconstruction: mean and variance of a level on a grid."""
    counts = np.full(3, CELLS)
    first, last = cloud.point.min(axis=0) - MARGIN, cloud.point.max(axis=0) + MARGIN
    step = (last - first) / (counts - 1)
    mean, variance, _ = gpytoolbox.stochastic_poisson_surface_reconstruction(
        cloud.point,
        cloud.normal,
        gs=counts,
        h=step,
        corner=first,
        output_variance=True,
        solve_subspace_dim=MODES,
    )
    axes = tuple(np.linspace(*ends, CELLS) for ends in zip(first, last, strict=True))
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3, order="F")
    vertices, faces, *_ = igl.marching_cubes(mean, nodes, CELLS, CELLS, CELLS, 0.0)
    level, its_variance = (np.reshape(each, counts, order="F") for each in (mean, variance))
    slope = np.linalg.norm(np.gradient(level, *step), axis=0)
    deviation = RegularGridInterpolator(axes, cloud.unit * np.sqrt(its_variance) / slope)
    return lambda truth: Found(
        _from_mesh(cloud.unit * vertices, faces, truth), deviation(truth / cloud.unit)
    )


def _from_mesh(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distances of points (n, 3) from a mesh."""
    return np.sqrt(igl.point_mesh_squared_distance(points, vertices, faces.astype(np.int64))[0])


def cloud_of(contacts: list[vb.Contacts]) -> Cloud:
    """What `fit_shape` uses of the contacts, in units of the longest side of their box."""
    point = np.concatenate([part.point for part in contacts])
    normal = np.concatenate([part.normal for part in contacts])
    used = np.concatenate([(part.kind > 0) & (part.status == 0) for part in contacts])
    used &= np.isfinite(point).all(axis=1) & np.isfinite(normal).all(axis=1)
    unit = float(np.ptp(point[used], axis=0).max())
    return Cloud(point[used] / unit, normal[used], unit)


def measured(name: str, method: Method, truth: np.ndarray, near: np.ndarray) -> tuple[str, float]:
    """A row without its time, and the seconds of the faster of two warm runs."""
    kept = []
    seconds = 1e-6 * best_of(2, lambda: kept.append(method()), 1)
    found = kept[-1](truth)
    mm = 1e3 * found.away
    row = f"{name:<20}{mm[near].mean():>12.4f}{np.quantile(mm[near], 0.95):>9.4f}"
    row += f"{mm[~near].mean():>9.4f}"
    if found.deviation is None:
        return f"{row}{'none':>12}{'':>16}", seconds
    inside = 100 * (found.away < HALF_WIDTH * found.deviation)
    stated = 1e3 * np.median(found.deviation[near])
    return f"{row}{stated:>12.4f}{inside[near].mean():>9.1f}{inside[~near].mean():>7.1f}", seconds


def main(names: list[str]) -> None:
    """Print a table for each object; times are multiples of the screened peer's."""
    for name, surface in OBJECTS.items():
        if names and not name.startswith(tuple(names)):
            continue
        contacts, truth = touched(surface, OFFSETS), spread(surface)
        cloud = cloud_of(contacts)
        near = KDTree(cloud.unit * cloud.point).query(truth)[0] < NEAR
        print(
            f"{name}: {len(contacts)} sweeps, {len(cloud.point)} contacts, "
            f"{100 * near.mean():.0f} % within {1e3 * NEAR:.0f} mm of one\n"
            f"{'mm, %':<20}{'near: mean':>12}{'95 %':>9}{'rest':>9}"
            f"{'deviation':>12}{'inside':>9}{'rest':>7}{'time':>8}"
        )
        methods: dict[str, Method] = {
            "screened Poisson": lambda cloud=cloud: screened(cloud),
            "stochastic Poisson": lambda cloud=cloud: stochastic(cloud),
            "vb.fit_shape": lambda contacts=contacts: fitted(contacts),
        }
        unit = None
        for title, method in methods.items():
            row, seconds = measured(title, method, truth, near)
            unit = unit or seconds
            print(f"{row}{seconds / unit:>8.1f}", flush=True)
        print(f"time 1 is {unit:.2f} s\n", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
