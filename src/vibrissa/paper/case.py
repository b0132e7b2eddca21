"""The paper's numerical example (section III): C = 0.5 x² + y² + 0.4, trails along −x, model
units.
"""

import numpy as np
from jaxtyping import Float

from vibrissa.rod import Rod
from vibrissa.surfaces import EllipticParaboloid
from vibrissa.trail import Trail

ROD = Rod.unit()
SURFACE = EllipticParaboloid(a=0.5, b=1.0, h=0.4)
Y0 = np.round(np.arange(-0.5, 0.55, 0.1), 10)
"""−0.5 : 0.1 : 0.5."""
PLANE = int(np.argmin(np.abs(Y0)))
"""The trail y0 = 0."""

REACH = (1.0, 0.7)
"""Half-widths of the surface region on which coverage is measured [L]."""
Grid = Float[np.ndarray, "*grid"]


def trails(count: int = 241, reach: float = 1.2) -> Trail:
    """The eleven trails y0 = −0.5 : 0.1 : 0.5, from x0 = `reach` to −`reach`."""
    start, stop = (reach, Y0[0], 0), (-reach, Y0[0], 0)
    return Trail.raster(start=start, stop=stop, count=count, step=(0, 0.1, 0), trails=len(Y0))


def plane_trail() -> Trail:
    """y0 = 0, past its snap-off at x0 = −1.342."""
    return Trail.line(start=(1.2, 0, 0), stop=(-1.4, 0, 0), count=521)


def perpendicular_trails(count: int = 241, reach: float = 1.2) -> Trail:
    """Sweeps across the trails, along −y, at x0 = −1 : 0.2 : 1, from y0 = `reach` to −`reach`."""
    return Trail.raster(
        start=(-1.0, reach, 0), stop=(-1.0, -reach, 0), count=count, step=(0.2, 0, 0), trails=11
    )


def further() -> dict[str, Trail]:
    """What the paper suggests: sweeps perpendicular to the trails, and at other distances (h = 0.2
    and 0.6 in place of 0.4); at those, both directions, from further out.
    """
    both = Trail.stack([trails(301, 1.5), perpendicular_trails(301, 1.5)])
    return {
        "perpendicular": perpendicular_trails(),
        "nearer": Trail(both.position + [0, 0, 0.2], both.orientation),
        "farther": Trail(both.position - [0, 0, 0.2], both.orientation),
    }


def on_surface(x: Grid, y: Grid) -> tuple[Grid, Grid, Grid]:
    """Coordinates x, y, C(x, y)."""
    return x, y, SURFACE.a * x**2 + SURFACE.b * y**2 + SURFACE.h


def region(step: float = 0.015) -> Float[np.ndarray, "n 3"]:
    """Points of the surface over |x| ≤ 1, |y| ≤ 0.7, evenly spread over its area: a grid thinned in
    proportion to the surface area of each cell.
    """
    x, y = np.meshgrid(*(np.arange(-reach, reach, step) + step / 2 for reach in REACH))
    area = np.sqrt(1 + (2 * SURFACE.a * x) ** 2 + (2 * SURFACE.b * y) ** 2)
    kept = np.random.default_rng(0).random(x.shape) < area / area.max()
    return np.column_stack(on_surface(x[kept], y[kept]))
