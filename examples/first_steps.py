"""Ten lines: scan an object, then find it again from the support reactions alone."""

import numpy as np

import vibrissa as vb


def main() -> float:
    """Return the largest distance between scanned and reconstructed contacts [m]."""
    rod = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
    sphere = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
    trail = vb.Trail.line(start=(0.04, 0.005, 0), stop=(-0.04, 0.005, 0), count=201)
    scan = vb.scan(rod, sphere, trail)
    for event in scan.events:
        print(f"{event.kind.name:18s} at x0 = {1e3 * event.clamp[0]:7.3f} mm")
    found = vb.reconstruct(rod, scan.reactions)
    return float(np.nanmax(np.linalg.norm(found.point - scan.point, axis=-1)))


if __name__ == "__main__":
    print(f"largest error {main():.1e} m")
