"""A fitted part against its CAD model: where it has too much or too little material, and where that
is more than the contacts' errors.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.stats import false_discovery_control, norm

from vibrissa.geometry.checks import not_negative, positive, share
from vibrissa.shape.area import vertex_areas
from vibrissa.shape.locate import Location
from vibrissa.shape.mesh import ShapeMesh
from vibrissa.shape.shape import Shape
from vibrissa.surfaces import Surface

DIVERGING = np.array([[0.23, 0.30, 0.75], [0.98, 0.98, 0.98], [0.71, 0.02, 0.15]])
"""Too little material blue, too much red, told apart by colour-blind readers too: the ends of the
map of Moreland (ISVC 2009).
"""
UNCERTAIN = np.array([0.72, 0.72, 0.72])
"""Grey, as no colour between them is."""
_MOST_SHOWN = 0.98
"""Share of the distances that a scale of colours holds."""
_NO_PART = 0.1
"""Distance from all of the model, relative to the extent of what was touched, beyond which no part
of it was: what is wrong by that everywhere was not made after it.
"""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A fitted part against its CAD model, at the vertices of its mesh.

    Attributes
    ----------
    mesh
        The fitted surface where it was seen, its own standard deviation with it.
    distance
        (v,) signed distance from the CAD surface, in the contacts' unit of length: positive where
        the part has too much material.
    deviation
        (v,) its standard deviation: of the fitted surface and, from a `Location`, of the pose.
    p_value
        (v,) probability of a distance at least as large on a part within the tolerance, adjusted
        for the number of vertices: of those up to some rate, at most that share is expected to be
        false discoveries.
    significant
        (v,) whether the part differs from the model there: `p_value` up to `rate`.
    tolerance, rate
        As given to `compare`.
    """

    mesh: ShapeMesh
    distance: Float[np.ndarray, "v"]
    deviation: Float[np.ndarray, "v"]
    p_value: Float[np.ndarray, "v"]
    significant: Bool[np.ndarray, "v"]
    tolerance: float
    rate: float

    def __repr__(self) -> str:
        """Return two lines: share that differs, and distances."""
        if not len(self.distance):
            return "Comparison: nothing was seen"
        low, high = self.distance.min(), self.distance.max()
        return (
            f"Comparison: {100 * self.share:.1f} % of the seen area differs by more than "
            f"{self.tolerance:.3g}\n"
            f"  distance: {low:+.3g} to {high:+.3g}, median deviation: "
            f"{np.median(self.deviation):.2g}"
        )

    @property
    def share(self) -> float:
        """Share of the seen area that differs significantly; NaN if nothing was seen."""
        area = vertex_areas(self.mesh.vertices, self.mesh.faces)
        return float(area[self.significant].sum() / area.sum()) if area.any() else np.nan

    @property
    def limit(self) -> float:
        """Distance at which colours end: 98 % of the vertices that differ significantly, or of all
        if none does, are closer to the model.
        """
        chosen = self.significant if self.significant.any() else slice(None)
        most = float(np.quantile(np.abs(self.distance[chosen]), _MOST_SHOWN))
        return most or np.finfo(float).tiny

    def colours(self, limit: float | None = None) -> UInt8[np.ndarray, "v 3"]:
        """Red, green and blue (v, 3), 0 to 255: blue where there is too little material, red where
        there is too much, grey where the difference is not significant.

        Parameters
        ----------
        limit
            Distance at which colours end; by default `limit`.

        Raises
        ------
        ValueError
            If the limit is not positive.
        """
        end = self.limit if limit is None else positive(limit, "limit")
        stops = [-end, 0.0, end]
        mixed = [np.interp(self.distance, stops, column) for column in DIVERGING.T]
        shown = np.where(self.significant[:, None], np.stack(mixed, axis=1), UNCERTAIN)
        return np.round(255 * shown).astype(np.uint8)


def compare(
    shape: Shape,
    model: Surface | Location,
    *,
    tolerance: float = 0.0,
    rate: float = 0.05,
    resolution: float | None = None,
) -> Comparison:
    """Where a fitted part differs from its CAD model by more than chance and a tolerance.

    Parameters
    ----------
    shape
        From `vibrissa.fit_shape`.
    model
        The part as designed, in the contacts' frame; or from `vibrissa.locate`, in its best pose,
        whose covariance then counts too. Motions that the pose leaves open count with a standard
        deviation of 1 rad or the contacts' extent; those of a symmetric object change nothing.
    tolerance
        Distance up to which the part counts as good, in the contacts' unit of length.
    rate
        Expected share of false ones among the vertices that are called different.
    resolution
        As in `Shape.mesh`.

    Raises
    ------
    ValueError
        If the tolerance is negative, the rate not between 0 and 1, the resolution not positive, or
        no surface of the model is near the part: it is in another frame or unit of length.
    ImportError
        If the libraries of `vibrissa[mesh]` are not installed.

    Notes
    -----
    With d the distance to either side, σ its deviation and τ the tolerance, the p value before
    adjustment is Φ((τ − d)/σ) + Φ((−τ − d)/σ): that of a part which is off by just the tolerance.
    Neighbouring vertices share their errors, hence the procedure of Benjamini & Yekutieli (Ann.
    Stat. 2001), which holds under any dependence. The pose counts to first order, as if its errors
    were independent of the shape's: where it was found from the same contacts, it follows part of
    their errors, and deviations are too large rather than too small. Deviations near contacts are
    not those of `shape`, which may be smaller: what halves of the sweeps tell of 95 % of all places
    does not hold for the few that are furthest.
    """
    not_negative(tolerance, "tolerance")
    share(rate, "rate")
    surface = model.placed if isinstance(model, Location) else model
    agreement = max(shape.level.agreement, 1.0)
    cautious = replace(shape, level=shape.level._replace(agreement=agreement))
    mesh = cautious.mesh(resolution)
    if not len(mesh.vertices):
        nothing = np.zeros(0)
        return Comparison(mesh, nothing, nothing, nothing, np.zeros(0, dtype=bool), tolerance, rate)
    distance, deviation = surface.distances(mesh.vertices), mesh.deviation
    nearest = float(np.min(np.abs(distance)))
    if nearest > _NO_PART * shape.extent:
        raise ValueError(
            f"model: its surface is at least {nearest:.3g} away from a part of {shape.extent:.3g}; "
            "allowed is a model in the contacts' frame and unit of length, such as the result of "
            "`vibrissa.locate`"
        )
    if isinstance(model, Location):
        deviation = np.sqrt(deviation**2 + _of_pose(model, surface, mesh.vertices))
    beyond = np.stack([np.abs(distance) - tolerance, np.abs(distance) + tolerance]) / deviation
    chance = np.minimum(norm.sf(beyond).sum(axis=0), 1.0)
    p_value = false_discovery_control(chance, method="by")
    return Comparison(mesh, distance, deviation, p_value, p_value <= rate, tolerance, rate)


def _of_pose(
    location: Location, surface: Surface, points: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, "v"]:
    """Variance of distances from an object whose pose is uncertain.

    Turned by ω about the middle of the contacts and moved by v, the object comes nearer to a point
    by n·(ω × a + v) = (a × n)·ω + n·v, with a from the middle to the point.
    """
    normal, best = surface.normal(points), location.poses[0]
    slope = np.hstack([np.cross(points - location.middle, normal), normal])
    spread = best.covariance + best.free.T @ best.free
    return np.einsum("vi,ij,vj->v", slope, spread, slope)
