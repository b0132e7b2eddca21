"""A surface of your own: any function that JAX can trace, as a height field or a level function."""

import jax.numpy as jnp
import numpy as np

import vibrissa as vb


def main() -> dict[str, int]:
    """Scan a wavy ceiling and a rounded tetrahedron; return how many positions were in contact with
    all checks passed.
    """
    rod = vb.Rod.unit()
    wavy = vb.surfaces.HeightField(lambda x, y: 0.85 + 0.05 * jnp.cos(3 * x) * jnp.cos(2 * y))
    corners = jnp.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / jnp.sqrt(3)
    # Positive outside: a smooth maximum of four planes.
    blob = vb.surfaces.Implicit(
        lambda p: (
            jnp.log(jnp.sum(jnp.exp(12 * (corners @ (p - jnp.array([0.0, 0.0, 1.0])))))) / 12 - 0.35
        )
    )
    trail = vb.Trail.raster(
        start=(0.9, -0.3, 0), stop=(-0.9, -0.3, 0), count=121, step=(0, 0.15, 0), trails=5
    )
    counts = {}
    for name, surface in (("wavy", wavy), ("blob", blob)):
        scan = vb.scan(rod, surface, trail)
        counts[name] = int(np.sum(scan.in_contact & (scan.status == vb.Status.OK)))
        print(
            f"{name}: {counts[name]} of {scan.kind.size} positions in contact with all checks "
            f"passed, {len(scan.events)} events"
        )
    return counts


if __name__ == "__main__":
    main()
