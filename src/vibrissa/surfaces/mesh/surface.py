"""A solid given by the triangles of its surface."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from pathlib import Path

import equinox as eqx
import numpy as np
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite
from vibrissa.numerics.progress import Guess, Progress
from vibrissa.surfaces.base import ExactSurface, Point, Scalar
from vibrissa.surfaces.mesh.build import STEPS, build
from vibrissa.surfaces.mesh.creases import sheets
from vibrissa.surfaces.mesh.field import Field, field_level
from vibrissa.surfaces.mesh.libraries import Faces, Vertices
from vibrissa.surfaces.mesh.reading import read
from vibrissa.surfaces.mesh.repair import Repairs, mended

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Source:
    """Triangles and repairs; equal for all meshes when JAX compares them, since no compiled code
    uses them.
    """

    vertices: Vertices = field(compare=False)
    faces: Faces = field(compare=False)
    repairs: Repairs = field(compare=False)


class Mesh(ExactSurface):
    """A closed triangle mesh, smoothed between its creases (mechanics.md, "Meshes").

    The level is the signed distance from a smooth surface through the vertices, of higher order
    than the triangles. Edges at which the mesh bends by more than `crease_angle` stay sharp:
    outside them the level is the distance from the edge.

    Parameters
    ----------
    vertices
        (v, 3), in units of the rod.
    faces
        (f, 3) indices of vertices, anticlockwise seen from outside.
    crease_angle
        Angle between neighbouring triangles above which their edge is sharp [rad].
    reach
        Distance from the surface up to which creases keep their shape [units of the rod]; default 2
        % of the diagonal, and at least 2.5 grid cells.
    progress
        `progress(done, total)` is called after each step of building the level, of about a second
        in large meshes; the total is a guess until it is known whether there are creases.

    Raises
    ------
    ValueError
        If the arrays are not a mesh, or it has defects that cannot be repaired: open edges, edges
        with more than two triangles, triangles that cross. The text counts them.
    ImportError
        If libigl is not installed; the text says how to get it.

    Notes
    -----
    Defects that can be repaired are: `repairs` says which, and the logger
    `vibrissa.surfaces.mesh.surface` warns of them.
    """

    heavy = True
    field: Field = eqx.field(repr=False)
    source: _Source = eqx.field(static=True, repr=False)

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        crease_angle: float = 0.7,
        reach: float | None = None,
        progress: Progress | None = None,
    ) -> None:
        angle = finite(crease_angle, "crease_angle")
        if not 0 < angle <= np.pi:
            raise ValueError(
                f"crease_angle = {crease_angle!r}; allowed is an angle between 0 and π [rad]"
            )
        steps = Guess(progress, STEPS + 2)
        self.source = _Source(*mended(vertices, faces))
        steps.step()
        diagonal = float(np.linalg.norm(np.ptp(self.vertices, axis=0)))
        distance = 0.02 * diagonal if reach is None else finite(reach, "reach")
        if not 0 <= distance <= diagonal:
            raise ValueError(
                f"reach = {reach!r}; allowed is a distance from 0 to the mesh's diagonal, "
                f"{diagonal:.6g}"
            )
        # Each triangle of an STL has its own vertices: merging those is no repair to speak of.
        if replace(self.repairs, merged_vertices=0):
            _LOG.warning("mesh mended: %s", self.repairs)
        smooth = sheets(self.vertices, self.faces, angle)
        steps.step()
        self.field = build(smooth, distance, steps)
        steps.end()

    def __repr__(self) -> str:
        """Return one line: how many triangles, and how large in units of the rod."""
        size = " × ".join(f"{extent:.4g}" for extent in np.ptp(self.vertices, axis=0))
        return f"Mesh of {len(self.faces)} triangles, {size}, watertight"

    @classmethod
    def load(
        cls,
        path: str | Path,
        scale: float | None = None,
        *,
        crease_angle: float = 0.7,
        reach: float | None = None,
        progress: Progress | None = None,
    ) -> Mesh:
        """Read STL, OBJ, PLY, glTF or GLB.

        Parameters
        ----------
        path
            The file; its suffix gives the format.
        scale
            Length of the file's unit, in units of the rod: 1e-3 for millimetres and a rod in SI.
            Required for STL, OBJ and PLY, which have no unit; glTF is in metres, so 1 unless given.
        crease_angle, reach, progress
            As for `Mesh`.

        Raises
        ------
        ValueError
            If the file cannot be read, is damaged, or holds no mesh; if `scale` is missing or not
            positive; as for `Mesh`.
        ImportError
            If trimesh or libigl is not installed; the text says how to get them.
        """
        vertices, faces = read(path, scale)
        try:
            return cls(vertices, faces, crease_angle=crease_angle, reach=reach, progress=progress)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    @property
    def branching(self) -> bool:  # type: ignore[override]
        """Whether single triangles are evaluated, which differ from point to point."""
        return self.field.triangles is not None

    @property
    def vertices(self) -> Vertices:
        """Vertices after repair (v, 3), in units of the rod."""
        return self.source.vertices

    @property
    def faces(self) -> Faces:
        """Faces after repair (f, 3), anticlockwise seen from outside."""
        return self.source.faces

    @property
    def repairs(self) -> Repairs:
        """What was repaired."""
        return self.source.repairs

    def level(self, point: Point) -> Scalar:
        """Signed distance; farther than `reach` from the surface, creases are rounded by about a
        grid cell.
        """
        return field_level(self.field, point)
