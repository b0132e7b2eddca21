"""Objects as TOML tables, one class a kind: a surface's arguments, and where it is placed."""

from math import pi
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from vibrissa import surfaces
from vibrissa.io.config import (
    NO_TURN,
    ORIGIN,
    Finite,
    Lengths,
    NotNegative,
    Positive,
    Quaternion,
    Table,
    Vector,
    number,
)

Exponent = Annotated[float, number("a number greater than 0 and at most 2", gt=0, le=2)]
CreaseAngle = Annotated[float, number("an angle greater than 0 and at most π [rad]", gt=0, le=pi)]


class PlacedTable(Table):
    """Rotation and translation, which any object may have."""

    rotation: Quaternion = NO_TURN
    translation: Vector = ORIGIN

    def build(self, folder: Path) -> Any:
        """Return the surface where the table puts it."""
        given = self.arguments(folder)
        shape = {name: given[name] for name in given.keys() - PlacedTable.model_fields}
        surface = type(self).noun(**shape)
        if (self.rotation, self.translation) == (NO_TURN, ORIGIN):
            return surface
        return surface.placed(self.rotation, self.translation)


class ParaboloidTable(PlacedTable):
    """Solid z > a x² + b y² + h."""

    noun = surfaces.EllipticParaboloid
    kind: Literal["elliptic_paraboloid"]
    a: Finite
    b: Finite
    h: Finite


class SphereTable(PlacedTable):
    """A ball."""

    noun = surfaces.Sphere
    kind: Literal["sphere"]
    center: Vector
    radius: Positive


class EllipsoidTable(PlacedTable):
    """An ellipsoid with its axes along x, y, z before it is turned."""

    noun = surfaces.Ellipsoid
    kind: Literal["ellipsoid"]
    center: Vector
    semi_axes: Lengths


class EllipticCylinderTable(PlacedTable):
    """A cylinder without ends along y before it is turned."""

    noun = surfaces.EllipticCylinder
    kind: Literal["elliptic_cylinder"]
    center: Vector
    semi_axes: tuple[Positive, Positive]


class PlaneTable(PlacedTable):
    """A half space."""

    noun = surfaces.Plane
    kind: Literal["plane"]
    point: Vector
    normal: Vector


class BoxTable(PlacedTable):
    """A block with its edges along x, y, z before it is turned."""

    noun = surfaces.Box
    kind: Literal["box"]
    center: Vector
    half_extents: Lengths


class CylinderTable(PlacedTable):
    """A circular cylinder with flat ends."""

    noun = surfaces.Cylinder
    kind: Literal["cylinder"]
    center: Vector
    axis: Vector
    radius: Positive
    length: Positive


class CapsuleTable(PlacedTable):
    """A cylinder with hemispherical ends; the length is that of the straight part."""

    noun = surfaces.Capsule
    kind: Literal["capsule"]
    center: Vector
    axis: Vector
    radius: Positive
    length: Positive


class ConeTable(PlacedTable):
    """A circular cone; the axis runs from the centre of the base to the apex."""

    noun = surfaces.Cone
    kind: Literal["cone"]
    center: Vector
    axis: Vector
    radius: Positive
    height: Positive


class TorusTable(PlacedTable):
    """A ring."""

    noun = surfaces.Torus
    kind: Literal["torus"]
    center: Vector
    axis: Vector
    major_radius: Positive
    minor_radius: Positive


class SuperquadricTable(PlacedTable):
    """A superquadric with its axes along x, y, z before it is turned."""

    noun = surfaces.Superquadric
    kind: Literal["superquadric"]
    center: Vector
    semi_axes: Lengths
    exponents: tuple[Exponent, Exponent]


class MeshTable(PlacedTable):
    """A closed mesh from a file."""

    kind: Literal["mesh"]
    file: Annotated[
        Path,
        Field(description="the path of a mesh, seen from the folder of the file that names it"),
    ]
    scale: Positive | None = None
    crease_angle: CreaseAngle | None = None
    reach: NotNegative | None = None

    def build(self, folder: Path) -> Any:
        """Return the surface; raise ValueError also where a library for meshes is missing."""
        try:
            return super().build(folder)
        except (ValueError, ImportError) as error:
            raise ValueError(f"file = {str(self.file)!r}: {error}") from error

    @staticmethod
    def noun(file: Path, **options: float) -> surfaces.Mesh:
        """Load the mesh."""
        return surfaces.Mesh.load(file, **options)


class UnionTable(PlacedTable):
    """Several objects as one; each part is the table of an object, placed in its own right."""

    noun = surfaces.Union
    kind: Literal["union"]
    parts: Annotated[
        list["ObjectTable"],
        Field(
            min_length=1,
            description="a list of at least one object, each a table with its own kind",
        ),
    ]


class OffsetTable(PlacedTable):
    """An object grown by a radius on all sides."""

    noun = surfaces.Offset
    kind: Literal["offset"]
    surface: "ObjectTable"
    radius: Positive


_KINDS = (
    "elliptic_paraboloid, sphere, ellipsoid, elliptic_cylinder, plane, box, cylinder, capsule, "
    "cone, torus, superquadric, mesh, union or offset"
)
ObjectTable = Annotated[
    ParaboloidTable
    | SphereTable
    | EllipsoidTable
    | EllipticCylinderTable
    | PlaneTable
    | BoxTable
    | CylinderTable
    | CapsuleTable
    | ConeTable
    | TorusTable
    | SuperquadricTable
    | MeshTable
    | UnionTable
    | OffsetTable,
    Field(discriminator="kind", description=_KINDS),
]
UnionTable.model_rebuild()
OffsetTable.model_rebuild()
