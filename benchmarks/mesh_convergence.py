"""How the contact on a mesh converges to that on the solid it was made from: `python
benchmarks/mesh_convergence.py [SUBDIVISIONS]`, by default up to 6 (81,920 faces).

An icosphere stretched to an ellipsoid; the chordal error is how far its triangles' centres lie
inside the ellipsoid.
"""

import sys
import time

import numpy as np
import trimesh

import vibrissa as vb

CENTER, SEMI_AXES = np.array([0.0, 0.0, 1.15]), np.array([0.6, 0.5, 0.55])
TRAIL = vb.Trail.raster(
    start=(1.1, -0.31, 0), stop=(-1.1, -0.3, 0), count=121, step=(0, 0.0061, 0), trails=100
)


def main() -> None:
    """Print one line per refinement."""
    rod, exact = vb.Rod.unit(), vb.surfaces.Ellipsoid(CENTER, SEMI_AXES)
    theirs = vb.scan(rod, exact, TRAIL)
    print(
        "    faces  build, s  chordal error  largest error  median error  order  µs a position  µs a contact"
    )
    before = np.nan
    for subdivisions in range(2, 1 + (int(sys.argv[1]) if len(sys.argv) > 1 else 6)):
        mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
        vertices = mesh.vertices * SEMI_AXES + CENTER
        start = time.perf_counter()
        surface = vb.surfaces.Mesh(vertices, mesh.faces)
        built = time.perf_counter() - start
        ours = vb.scan(rod, surface, TRAIL)
        times = []
        for _ in range(3):
            start = time.perf_counter()
            vb.scan(rod, surface, TRAIL)
            times.append(time.perf_counter() - start)
        both = (
            ours.in_contact
            & theirs.in_contact
            & (ours.status == vb.Status.OK)
            & (theirs.status == vb.Status.OK)
        )
        error = np.linalg.norm(ours.point - theirs.point, axis=-1)[both]
        chordal = -exact.distances(vertices[mesh.faces].mean(axis=1)).min()
        order = np.log2(before / error.max())
        print(
            f"{len(mesh.faces):9d} {built:9.1f} {chordal:14.1e} {error.max():14.1e} {np.median(error):13.1e} {order:6.1f}"
            f" {1e6 * min(times) / ours.kind.size:14.1f} {1e6 * min(times) / ours.in_contact.sum():13.1f}",
            flush=True,
        )
        before = error.max()


if __name__ == "__main__":
    main()
