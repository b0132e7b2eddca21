"""Objects as TOML tables, one class a kind: the arguments of the surface, and where it is placed."""

from math import pi
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from vibrissa.io.config import (
    NO_TURN,
    ORIGIN,
    Finite,
    NotNegative,
    Positive,
    Quaternion,
    Table,
    Vector,
)
from vibrissa.surfaces import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    EllipticCylinder,
    EllipticParaboloid,
    Mesh,
    Offset,
    Plane,
    Sphere,
    Superquadric,
    Surface,
    Torus,
    Union,
)

Exponent = Annotated[
    float,
    Field(
        strict=True,
        gt=0,
        le=2,
        allow_inf_nan=False,
        description="a number greater than 0 and at most 2",
    ),
]
CreaseAngle = Annotated[
    float,
    Field(
        strict=True,
        gt=0,
        le=pi,
        allow_inf_nan=False,
        description="an angle greater than 0 and at most π [rad]",
    ),
]


class PlacedTable(Table):
    """Rotation and translation, which any object may have."""

    rotation: Quaternion = NO_TURN
    translation: Vector = ORIGIN

    def placed(self, surface: Surface) -> Surface:
        """Return the surface where the table puts it."""
        return (
            surface
            if (self.rotation, self.translation) == (NO_TURN, ORIGIN)
            else surface.placed(self.rotation, self.translation)
        )


class ParaboloidTable(PlacedTable):
    """Solid z > a x² + b y² + h."""

    kind: Literal["elliptic_paraboloid"]
    a: Finite
    b: Finite
    h: Finite

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(EllipticParaboloid(self.a, self.b, self.h))


class SphereTable(PlacedTable):
    """A ball."""

    kind: Literal["sphere"]
    center: Vector
    radius: Positive

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Sphere(self.center, self.radius))


class EllipsoidTable(PlacedTable):
    """An ellipsoid with its axes along x, y, z before it is turned."""

    kind: Literal["ellipsoid"]
    center: Vector
    semi_axes: tuple[Positive, Positive, Positive]

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Ellipsoid(self.center, self.semi_axes))


class EllipticCylinderTable(PlacedTable):
    """A cylinder without ends along y before it is turned."""

    kind: Literal["elliptic_cylinder"]
    center: Vector
    semi_axes: tuple[Positive, Positive]

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(EllipticCylinder(self.center, self.semi_axes))


class PlaneTable(PlacedTable):
    """A half space."""

    kind: Literal["plane"]
    point: Vector
    normal: Vector

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Plane(self.point, self.normal))


class BoxTable(PlacedTable):
    """A block with its edges along x, y, z before it is turned."""

    kind: Literal["box"]
    center: Vector
    half_extents: tuple[Positive, Positive, Positive]

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Box(self.center, self.half_extents))


class CylinderTable(PlacedTable):
    """A circular cylinder with flat ends."""

    kind: Literal["cylinder"]
    center: Vector
    axis: Vector
    radius: Positive
    length: Positive

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Cylinder(self.center, self.axis, self.radius, self.length))


class CapsuleTable(PlacedTable):
    """A cylinder with hemispherical ends; the length is that of the straight part."""

    kind: Literal["capsule"]
    center: Vector
    axis: Vector
    radius: Positive
    length: Positive

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Capsule(self.center, self.axis, self.radius, self.length))


class ConeTable(PlacedTable):
    """A circular cone; the axis runs from the centre of the base to the apex."""

    kind: Literal["cone"]
    center: Vector
    axis: Vector
    radius: Positive
    height: Positive

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Cone(self.center, self.axis, self.radius, self.height))


class TorusTable(PlacedTable):
    """A ring."""

    kind: Literal["torus"]
    center: Vector
    axis: Vector
    major_radius: Positive
    minor_radius: Positive

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Torus(self.center, self.axis, self.major_radius, self.minor_radius))


class SuperquadricTable(PlacedTable):
    """A superquadric with its axes along x, y, z before it is turned."""

    kind: Literal["superquadric"]
    center: Vector
    semi_axes: tuple[Positive, Positive, Positive]
    exponents: tuple[Exponent, Exponent]

    def build(self) -> Surface:
        """Return the surface."""
        return self.placed(Superquadric(self.center, self.semi_axes, self.exponents))


class MeshTable(PlacedTable):
    """A closed mesh from a file."""

    kind: Literal["mesh"]
    file: Annotated[
        str,
        StringConstraints(strict=True, min_length=1),
        Field(description="the path of a mesh, seen from the folder of the file that names it"),
    ]
    scale: Positive | None = None
    crease_angle: CreaseAngle | None = None
    reach: NotNegative | None = None

    def build(self, folder: Path) -> Surface:
        """Return the surface; a path that is not absolute starts at `folder`. Raise ValueError also
        where a library for meshes is missing.
        """
        angle = {} if self.crease_angle is None else {"crease_angle": self.crease_angle}
        try:
            return self.placed(Mesh.load(folder / self.file, self.scale, reach=self.reach, **angle))
        except (ValueError, ImportError) as error:
            raise ValueError(f"file = {self.file!r}: {error}") from error


class UnionTable(PlacedTable):
    """Several objects as one; each part is the table of an object, placed in its own right."""

    kind: Literal["union"]
    parts: Annotated[
        list["ObjectTable"],
        Field(
            min_length=1,
            description="a list of at least one object, each a table with its own kind",
        ),
    ]

    def build(self, folder: Path) -> Surface:
        """Return the surface; files of its parts are seen from `folder`."""
        return self.placed(Union([built(part, folder) for part in self.parts]))


class OffsetTable(PlacedTable):
    """An object grown by a radius on all sides."""

    kind: Literal["offset"]
    surface: "ObjectTable"
    radius: Positive

    def build(self, folder: Path) -> Surface:
        """Return the surface; files are seen from `folder`."""
        return self.placed(Offset(built(self.surface, folder), self.radius))


_KINDS = "elliptic_paraboloid, sphere, ellipsoid, elliptic_cylinder, plane, box, cylinder, capsule, cone, torus, superquadric, mesh, union or offset"
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


def built(table: ObjectTable, folder: Path) -> Surface:
    """Surface of a table in a file of this folder; raise ValueError as the surface's own
    constructor does.
    """
    return (
        table.build(folder)
        if isinstance(table, MeshTable | UnionTable | OffsetTable)
        else table.build()
    )
