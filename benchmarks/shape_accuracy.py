"""How well five objects are known that were touched all over: `uv run --extra mesh python
benchmarks/shape_accuracy.py [NAME ...]`; each NAME selects the objects whose names begin with it.

A wire of 50 mm on a sensor of 2 mN and 0.04 N mm sweeps them from six sides, 6 mm apart in two
directions: scanned, measured, reconstructed, smoothed. The surface through all contacts, and through
600 of them, is compared with the truth where it is within 3 mm of a contact, and elsewhere.
"""

import sys
import time

import jax.numpy as jnp
import numpy as np

import vibrissa as vb
from touching import touched

OFFSETS = 6e-3 * np.arange(-3, 4)
"""Of the sweeps of one direction from a side's middle [m]."""
FEW = 600
CENTERS = 1e-3 * np.array([[14.0, 0, 0], [-14, 0, 0], [0, 0, -12]])
"""Of three balls that grow into one another: the blob is concave between them [m]."""


def blob(point):
    """A smooth least distance from three balls of 12 mm."""
    apart = jnp.sqrt(jnp.sum((point - CENTERS) ** 2, axis=1) + 1e-12) - 0.012
    return -0.004 * jnp.log(jnp.sum(jnp.exp(-apart / 0.004)))


OBJECTS: dict[str, vb.surfaces.Surface] = {
    "sphere": vb.surfaces.Sphere(center=(0, 0, 0), radius=0.022),
    "ellipsoid": vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.028, 0.022, 0.017)),
    "torus": vb.surfaces.Torus(
        center=(0, 0, 0), axis=(0, 0.3, 1), major_radius=0.020, minor_radius=0.008
    ),
    "rounded block": vb.surfaces.Offset(
        vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.019, 0.014, 0.011)), 0.003
    ),
    "concave blob": vb.surfaces.Implicit(blob),
}


def main(names: list[str]) -> None:
    """Print two rows for each object."""
    print(
        f"{'mm, degrees, %':<15}{'contacts':>9}{'chamfer':>9}{'95 %':>8}{'normals':>9}{'95 %':>7}"
        f"{'deviation':>11}{'inside':>8}{'rest':>7}{'outliers':>10}{'fit, s':>8}"
    )
    for name, surface in OBJECTS.items():
        if names and not name.startswith(tuple(names)):
            continue
        contacts = vb.Contacts.joined(touched(surface, OFFSETS, crosswise=True))
        sound = np.flatnonzero((contacts.kind > 0) & (contacts.status == 0))
        for count in (len(sound), FEW):
            rows = sound[np.linspace(0, len(sound) - 1, count).round().astype(int)]
            start = time.perf_counter()
            shape = vb.fit_shape(contacts[rows])
            seconds = time.perf_counter() - start
            errors = vb.shape_errors(shape, surface, contacts=contacts[rows].point)
            near, rest = errors.touched, errors.rest
            print(
                f"{name:<15}{count:>9}{1e3 * near.chamfer:>9.4f}{1e3 * near.percentile_95:>8.3f}"
                f"{near.normal_median:>9.2f}{near.normal_95:>7.2f}{1e3 * near.deviation:>11.4f}"
                f"{100 * near.inside:>8.1f}{100 * rest.inside:>7.1f}"
                f"{100 * shape.outlier.mean():>10.2f}{seconds:>8.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1:])
