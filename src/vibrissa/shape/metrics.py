"""How far a fitted surface is from the true one, where it was touched and elsewhere."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from scipy.special import ndtri

from vibrissa.geometry.checks import finite_array, positive, whole_number
from vibrissa.shape.area import points_over, vertex_areas
from vibrissa.shape.coverage import coverage
from vibrissa.shape.shape import Shape
from vibrissa.surfaces import Surface

_REACH, _BEYOND = 20.0, 0.25
"""How far from the contacts an object may end, relative to their extent, and how much beyond them
counts of one that does not, as of a plane.
"""


class Errors(NamedTuple):
    """Errors of a part of the surface, in the contacts' unit of length; NaN if the part is empty.

    From the truth to the shape, points evenly spread over the truth are compared with the mean
    surface; from the shape to the truth, the vertices of its mesh, weighted by area. Each side is
    compared with the whole of the other.
    """

    mean: float
    """Mean absolute distance from the truth to the shape."""
    chamfer: float
    """Half the sum of the mean absolute distances in both directions."""
    percentile_95: float
    """Distance that 95 % of the truth and 95 % of the shape do not exceed."""
    hausdorff: float
    """Largest distance in either direction, among the points compared."""
    normal_median: float
    """Median angle between the normal of the truth and that of the closest place on the shape
    [°].
    """
    normal_95: float
    """95th percentile of that angle [°]."""
    inside: float
    """Share of the truth within the shape's 95 % interval."""
    deviation: float
    """Median standard deviation that the shape states on the truth."""


class ShapeErrors(NamedTuple):
    """Errors of a fitted surface: of what lies near a contact, of the rest, and of all."""

    touched: Errors
    """Near a contact."""
    rest: Errors
    """Elsewhere."""
    whole: Errors
    """Of all."""
    share_touched: float
    """Share of the truth near a contact."""
    spurious: float
    """Share of the shape's seen mesh, by area, that is off the truth by more than the tolerance."""

    def __repr__(self) -> str:
        """Return a table, a row for each figure."""
        parts = [self.touched, self.rest, self.whole]
        heads = "".join(f"{name:>12}" for name in ("touched", "rest", "whole"))
        rows = [
            f"{name:<16}" + "".join(f"{getattr(part, name):>12.4g}" for part in parts)
            for name in Errors._fields
        ]
        return "\n".join(
            [
                f"ShapeErrors: {100 * self.share_touched:.1f} % of the truth touched, "
                f"{100 * self.spurious:.1f} % of the seen mesh spurious",
                f"{'':<16}{heads}",
                *rows,
            ]
        )


class _Apart(NamedTuple):
    """What is compared at points of the truth, or at vertices of the shape."""

    distance: Float[np.ndarray, "n"]
    weight: Float[np.ndarray, "n"]
    near: Bool[np.ndarray, "n"]


def shape_errors(
    shape: Shape,
    truth: Surface,
    *,
    contacts: Float[np.ndarray, "k 3"] | None = None,
    near: float = 3e-3,
    tolerance: float = 1e-3,
    samples: int = 4000,
    resolution: float | None = None,
    seed: int = 0,
) -> ShapeErrors:
    """Errors of a fitted surface against the true one, both where it was touched and elsewhere.

    Parameters
    ----------
    shape
        From `vibrissa.fit_shape`.
    truth
        The object in the contacts' frame and unit of length; of one without end, as a plane, what
        lies within a quarter of the contacts' extent from them.
    contacts
        Contact points (k, 3) that say what was touched; those of the shape by default.
    near
        Distance from a contact up to which a place counts as touched; 3 mm by default, with lengths
        in metres.
    tolerance
        Distance from the truth beyond which seen parts of the mesh are spurious; 1 mm by default.
    samples
        Points of the truth.
    resolution
        As in `Shape.mesh`.
    seed
        Of the random points.

    Raises
    ------
    ValueError
        If `near`, `tolerance` or `resolution` is not positive, there is no sample, no contact is
        finite, or nothing of the truth is near the contacts.
    ImportError
        If the libraries of `vibrissa[mesh]` are not installed.
    """
    positive(near, "near")
    positive(tolerance, "tolerance")
    touched = shape.sites.touched if contacts is None else _finite_points(contacts)
    points = points_over(
        truth,
        touched,
        _REACH * shape.extent,
        _BEYOND * shape.extent,
        whole_number(samples, "samples"),
        np.random.default_rng(seed),
        said="truth: nothing of it is near the contacts",
    )
    points = truth.nearest(points)  # triangles of a round object lie off it
    feet, deviation = shape.nearest(points), shape.deviation(points)
    mesh = shape.mesh(resolution, extrapolate=True)
    away = np.linalg.norm(points - feet, axis=1)
    share_touched, near_truth = coverage(touched, points, near)
    there = _Apart(_bounded(away, points, mesh.vertices), np.ones(len(points)), near_truth)
    off = np.abs(truth.distances(mesh.vertices))
    area = vertex_areas(mesh.vertices, mesh.faces)
    near_shape = coverage(touched, mesh.vertices, near)[1]
    back = _Apart(_bounded(off, mesh.vertices, points), area, near_shape)
    cosine = np.einsum("ni,ni->n", truth.normal(points), shape.normal(feet))
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))

    def part(rows: Bool[np.ndarray, "n"], vertices: Bool[np.ndarray, "v"]) -> Errors:
        one, other = (
            (side.distance[chosen], side.weight[chosen])
            for side, chosen in ((there, rows), (back, vertices))
        )
        inside = there.distance[rows] < ndtri(0.975) * deviation[rows]
        return Errors(
            mean=_mean(*one),
            chamfer=0.5 * (_mean(*one) + _mean(*other)),
            percentile_95=_larger(_quantile(*one, 0.95), _quantile(*other, 0.95)),
            hausdorff=_larger(_quantile(*one, 1.0), _quantile(*other, 1.0)),
            normal_median=_quantile(angle[rows], one[1], 0.5),
            normal_95=_quantile(angle[rows], one[1], 0.95),
            inside=_mean(inside.astype(float), one[1]),
            deviation=_quantile(deviation[rows], one[1], 0.5),
        )

    return ShapeErrors(
        touched=part(there.near, back.near),
        rest=part(~there.near, ~back.near),
        whole=part(np.ones_like(there.near), np.ones_like(back.near)),
        share_touched=share_touched,
        spurious=_mean((back.distance > tolerance)[mesh.seen].astype(float), area[mesh.seen]),
    )


def _finite_points(contacts: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "n 3"]:
    """Rows that are finite."""
    points = contacts[np.isfinite(contacts).all(axis=-1)]
    if not points.size:
        raise ValueError("contacts: no row is finite; allowed is at least one")
    return finite_array(points, "contacts", last=3, ndim=2)


def _bounded(
    distance: Float[np.ndarray, "n"], points: Float[np.ndarray, "n 3"], others: np.ndarray
) -> Float[np.ndarray, "n"]:
    """Distances, no larger than those from points of the other surface: the closest place found may
    be one of several.
    """
    return np.minimum(distance, KDTree(others).query(points)[0]) if len(others) else distance


def _mean(values: Float[np.ndarray, "n"], weights: Float[np.ndarray, "n"]) -> float:
    return float(np.average(values, weights=weights)) if weights.any() else np.nan


def _quantile(values: Float[np.ndarray, "n"], weights: Float[np.ndarray, "n"], q: float) -> float:
    if not weights.any():
        return np.nan
    return float(np.quantile(values, q, weights=weights, method="inverted_cdf"))


def _larger(one: float, other: float) -> float:
    """The larger of two numbers, one of which may be unknown."""
    return float(np.fmax(one, other))
