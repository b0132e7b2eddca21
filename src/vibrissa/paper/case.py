"""The paper's numerical example (section III): C = 0.5 x² + y² + 0.4, trails along −x, model units."""

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

REACH_X, REACH_Y = 1.0, 0.7
"""Half widths of the surface region on which coverage is measured [L]."""


def trails(count: int = 241, reach: float = 1.2) -> Trail:
    """The eleven trails y0 = −0.5 : 0.1 : 0.5, from x0 = `reach` to −`reach`."""
    return Trail.raster(
        start=(reach, Y0[0], 0),
        stop=(-reach, Y0[0], 0),
        count=count,
        step=(0, 0.1, 0),
        trails=len(Y0),
    )


def plane_trail(count: int = 521) -> Trail:
    """y0 = 0, on to its snap-off at x0 = −1.342."""
    return Trail.line(start=(1.2, 0, 0), stop=(-1.4, 0, 0), count=count)


def perpendicular_trails(count: int = 241, reach: float = 1.2) -> Trail:
    """Sweeps across the trails, along −y, at x0 = −1 : 0.2 : 1, from y0 = `reach` to −`reach`."""
    return Trail.raster(
        start=(-1.0, reach, 0), stop=(-1.0, -reach, 0), count=count, step=(0.2, 0, 0), trails=11
    )


def crossed(count: int = 301, reach: float = 1.5) -> Trail:
    """Both, from further out."""
    return Trail.stack([trails(count, reach), perpendicular_trails(count, reach)])


def further() -> dict[str, Trail]:
    """What the paper suggests: sweeps perpendicular to the trails, and at other distances: h = 0.4
    becomes 0.2 and 0.6.
    """
    both = crossed()
    return {
        "perpendicular": perpendicular_trails(),
        "nearer": Trail(both.position + [0, 0, 0.2], both.orientation),
        "farther": Trail(both.position - [0, 0, 0.2], both.orientation),
    }


def height(
    x: Float[np.ndarray, "*batch"], y: Float[np.ndarray, "*batch"]
) -> Float[np.ndarray, "*batch"]:
    """C(x, y)."""
    return np.asarray(SURFACE.a * x**2 + SURFACE.b * y**2 + SURFACE.h)


def region(step: float = 0.015) -> Float[np.ndarray, "n 3"]:
    """Points of the surface over |x| ≤ 1, |y| ≤ 0.7, evenly spread over its area: a grid thinned by
    the share of area each cell has.
    """
    x, y = np.meshgrid(
        np.arange(-REACH_X, REACH_X, step) + step / 2, np.arange(-REACH_Y, REACH_Y, step) + step / 2
    )
    area = np.sqrt(1 + (2 * SURFACE.a * x) ** 2 + (2 * SURFACE.b * y) ** 2)
    kept = np.random.default_rng(0).random(x.shape) < area / area.max()
    x, y = x[kept], y[kept]
    return np.column_stack([x, y, height(x, y)])


def patch(
    count: int = 61,
) -> tuple[Float[np.ndarray, "i j"], Float[np.ndarray, "i j"], Float[np.ndarray, "i j"]]:
    """Grids x, y, z of the surface for figures."""
    x, y = np.meshgrid(np.linspace(-1.15, 1.15, count), np.linspace(-0.8, 0.8, count))
    return x, y, height(x, y)
