"""A mug with a handle, as a mesh: built from solids by their level functions, and triangulated.
Lengths in millimetres.

Unions and differences of solids are minima and maxima of their levels, here rounded by a radius, so
that the mug has no sharp edges. The triangles come from libigl's marching cubes on a coarse grid,
and are then evened out along the surface, with every vertex on it.
"""

from pathlib import Path

import igl
import jax.numpy as jnp
import numpy as np
import trimesh
from jax import Array

import vibrissa as vb

FILE = Path(__file__).parent / "meshes" / "mug.ply"
RADIUS, HEIGHT, WALL, BOTTOM = 22.0, 44.0, 5.0, 5.0
HANDLE, THICKNESS = 13.0, 3.5
CELL, MARGIN, PASSES = 1.3, 3.0, 10


def both(first: Array, second: Array, radius: float) -> Array:
    """Level of the intersection of two solids, with its edges rounded."""
    corner = jnp.maximum(jnp.stack([first, second]) + radius, 1e-12)
    return jnp.minimum(jnp.maximum(first, second), -radius) + jnp.linalg.norm(corner)


def mug() -> vb.surfaces.Surface:
    """The solid: upright on z = 0, the handle towards +x."""
    outside = _rounded((0, 0, HEIGHT / 2), RADIUS, HEIGHT, WALL / 2)
    # Sticks out of the top by its wall, as it is rounded by that much.
    depth = HEIGHT - BOTTOM + 2 * WALL
    inside = _rounded((0, 0, BOTTOM + depth / 2), RADIUS - WALL, depth, WALL)
    handle = vb.surfaces.Torus(
        center=(RADIUS, 0, HEIGHT / 2), axis=(0, 1, 0), major_radius=HANDLE, minor_radius=THICKNESS
    )

    def level(point: Array) -> Array:
        body = -both(-outside.level(point), -handle.level(point), 3.0)
        return both(body, -inside.level(point), WALL / 2)

    return vb.surfaces.Implicit(level)


def _rounded(
    center: tuple[float, float, float], radius: float, length: float, edge: float
) -> vb.surfaces.Surface:
    """An upright cylinder with rounded edges."""
    return vb.surfaces.Offset(
        vb.surfaces.Cylinder(center, (0, 0, 1), radius - edge, length - 2 * edge), edge
    )


def triangles(surface: vb.surfaces.Surface) -> trimesh.Trimesh:
    """Triangulate the mug's surface."""
    low, high = (
        np.array([-RADIUS, -RADIUS, 0]) - MARGIN,
        np.array([RADIUS + HANDLE + THICKNESS, RADIUS, HEIGHT]) + MARGIN,
    )
    counts = np.ceil((high - low) / CELL).astype(int) + 1
    # libigl expects x to vary fastest.
    grid = (
        (low + CELL * np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1))
        .transpose(2, 1, 0, 3)
        .reshape(-1, 3)
    )
    vertices, faces, _ = igl.marching_cubes(surface.levels(grid), grid, *map(int, counts), 0.0)
    mesh = trimesh.Trimesh(vertices, faces)
    for _ in range(PASSES):
        trimesh.smoothing.filter_laplacian(mesh, iterations=1, volume_constraint=False)
        mesh.vertices = surface.nearest(mesh.vertices)
    return mesh


def main(path: Path = FILE) -> trimesh.Trimesh:
    """Write the mesh and return it."""
    mesh = triangles(mug())
    mesh.export(path)
    return mesh


if __name__ == "__main__":
    main()
