"""A surface known from touch: signed distance with its uncertainty, and its mesh."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates

from vibrissa.contacts import Contacts
from vibrissa.geometry.checks import finite_array, positive
from vibrissa.shape.level import Level
from vibrissa.shape.mesh import ShapeMesh, box_of, extracted, lattice_of
from vibrissa.shape.occupancy import Occupancy, lattice_points, probability_inside
from vibrissa.shape.sites import Sites, thickness
from vibrissa.shape.stated import Stated, farthest

if TYPE_CHECKING:
    from vibrissa.surfaces import Surface

_KNOWN = 0.01
"""Standard deviation, relative to the extent of the contacts, below which a surface counts as seen:
its 95 % interval is then a twenty-fifth of the object's size wide.
"""


_NEXT = 2.0
"""Voxels from the surface within which deviations are not interpolated."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A surface fitted to contacts by `fit_shape`, in their unit of length.

    Attributes
    ----------
    level
        The random level function behind it.
    extent
        Diagonal of the box around all contacts.
    sites
        The contacts it was fitted to, neighbours of a sweep pooled.
    outlier
        (n,) which of the given rows are contacts that the surface contradicts by far more than
        their errors as stated. They hardly count.
    warnings
        What the contacts say against one another, one line each.
    contacts
        What it was fitted to.
    used
        (n,) which of their rows count: those with a contact and status OK.
    swept
        (k, 3) points of rods that missed, None if none were given.
    length_scale
        As it was given, or None.
    """

    level: Level
    extent: float
    sites: Sites
    outlier: Bool[np.ndarray, "given"]
    warnings: list[str]
    contacts: list[Contacts]
    used: Bool[np.ndarray, "given"]
    swept: Float[np.ndarray, "k 3"] | None
    length_scale: float | None

    def __repr__(self) -> str:
        """Return three lines: contacts, outliers and scales."""
        used, kernel = int(self.sites.size.sum()), self.level.found.basis.kernel
        return (
            f"Shape from {used} contacts of {len(np.unique(self.sites.sweep))} sweeps\n"
            f"  outliers: {self.outlier.sum()}, warnings: {len(self.warnings)}\n"
            f"  extent: {self.extent:.3g}, length scale: {kernel.smooth.length:.3g}"
        )

    def distance(self, points: ArrayLike) -> Float[np.ndarray, "*rows"]:
        """Signed distance of points (…, 3) from the mean surface, positive outside.

        Raises
        ------
        ValueError
            If a point is not finite, or the last axis is not 3.
        """
        return self._rows(points, self._distances)

    def deviation(self, points: ArrayLike) -> Float[np.ndarray, "*rows"]:
        """Standard deviation of the surface's place at points (…, 3) on or near it: what its
        distance from them is uncertain by. Raises ValueError as `distance` does.
        """
        return self._rows(points, self._deviations)

    def gradient(self, points: ArrayLike) -> Float[np.ndarray, "*rows 3"]:
        """Gradient of `distance` at points (…, 3): the outward unit normal of the surface next to
        them. Raises ValueError as `distance` does.
        """
        return self._rows(points, lambda flat: self.level.feet(flat, self.extent).normal)

    def normal(self, points: ArrayLike) -> Float[np.ndarray, "*rows 3"]:
        """Outward unit normals (…, 3) at points (…, 3) near the surface. Raises ValueError as
        `distance` does.
        """
        return self.gradient(points)

    def nearest(self, points: ArrayLike) -> Float[np.ndarray, "*rows 3"]:
        """Points (…, 3) of the mean surface closest to points (…, 3). Raises ValueError as
        `distance` does.
        """
        return self._rows(points, lambda flat: self.level.feet(flat, self.extent).place)

    def mesh(self, resolution: float | None = None, *, extrapolate: bool = False) -> ShapeMesh:
        """Triangles of the mean surface, where the contacts say something.

        Parameters
        ----------
        resolution
            Edge length of the cells that are cut; by default a sixtieth of the extent, or half the
            thickness of a thin object, down to a two-hundredth.
        extrapolate
            Whether to return the whole surface, closed unless it leaves three times the contacts'
            box, rather than only what is seen.

        Raises
        ------
        ValueError
            If the resolution is not positive, larger than the contacts' extent, or so small that
            there would be more than fifty million cells.
        ImportError
            If libigl is not installed.
        """
        step = self._spacing(resolution, self._fine())
        known = _KNOWN * self.extent
        mesh = extracted(
            self.level,
            self.sites.touched,
            step,
            self.extent,
            self._deviations,
            known,
            within=np.inf if extrapolate else farthest(known, self.extent),
        )
        return mesh if extrapolate else mesh.seen_part()

    def _spacing(self, resolution: float | None, usual: float) -> float:
        """Of a lattice, as asked for or as usual."""
        if resolution is None:
            return usual
        if positive(resolution, "resolution") > self.extent:
            raise ValueError(
                f"resolution = {resolution:.3g}; allowed is at most the contacts' extent, "
                f"{self.extent:.3g}"
            )
        return float(resolution)

    def _fine(self) -> float:
        """Edge length of cells that no thin part of the object slips through."""
        thick = thickness(self.sites.touched, self.sites.normal, self.extent)
        return float(np.clip(thick / 2, self.extent / 200, self.extent / 60))

    def surface(self, resolution: float | None = None) -> "Surface":
        """The mean surface, closed where it was not seen, as an object to scan again.

        Parameters
        ----------
        resolution
            Spacing of the lattice between whose nodes its level is interpolated by cubic splines;
            by default a fiftieth of the extent.

        Raises
        ------
        ValueError
            If the resolution is not positive, larger than the contacts' extent, or so small that
            there would be more than fifty million nodes.
        """
        from vibrissa.surfaces import Lattice  # noqa: PLC0415

        step = self._spacing(resolution, self.extent / 50)
        origin, values = lattice_of(self.level, self.sites.touched, step, self.extent)
        return Lattice(origin=origin, spacing=step, values=values)

    def occupancy(self, resolution: float | None = None) -> Occupancy:
        """Probability that the object fills the voxels of a lattice around it.

        Parameters
        ----------
        resolution
            Edge length of a voxel; by default a thirtieth of the extent.

        Raises
        ------
        ValueError
            If the resolution is not positive, larger than the contacts' extent, or so small that
            there would be more than fifty million voxels.

        Notes
        -----
        It is Φ(−d/σ) with d the distance of the voxel's middle, and σ the standard deviation of the
        surface's place. Voxels are unknown where the surface is not seen, as in a mesh, and its
        95 % interval reaches them. More than two voxels from the surface σ is interpolated between
        every other voxel.
        """
        step = self._spacing(resolution, self.extent / 30)
        origin, counts = box_of(self.level, self.sites.touched, step, self.extent)
        points = lattice_points(origin, step, counts)
        away = self.level.distances(points, _NEXT * step, self.extent)
        # Between every other voxel where they are not next to the surface.
        half = counts // 2 + 1
        few = self._deviations(lattice_points(origin, 2 * step, half)).reshape(half)
        between = np.indices(tuple(counts)).reshape(3, -1) / 2
        deviation = map_coordinates(few, between, order=1)
        near = np.abs(away) < _NEXT * step
        deviation[near] = self._deviations(points[near])
        inside = probability_inside(away, deviation, _KNOWN * self.extent)
        return Occupancy(origin, step, inside.reshape(counts))

    def _rows(self, points: ArrayLike, function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        array = finite_array(points, "points", last=3)
        found = function(array.reshape(-1, 3))
        return found.reshape(array.shape[:-1] + found.shape[1:])

    def _distances(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        return self.level.feet(points, self.extent).distance

    def _deviations(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        stated = Stated.at(self.level, points, self.sites.touched, self.extent)
        return stated.deviations(self.level.variance(stated.feet.raised))
