"""Objects as TOML tables: a surface's arguments and its placement."""

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
    Site,
    Table,
    Vector,
    number,
    one_of,
    several,
    table_of,
)

Exponent = Annotated[float, number("a number greater than 0 and at most 2", gt=0, le=2)]
CreaseAngle = Annotated[float, number("an angle greater than 0 and at most π [rad]", gt=0, le=pi)]


class PlacedTable(Table):
    """Rotation and translation, which any object may have."""

    rotation: Quaternion = NO_TURN
    translation: Vector = ORIGIN

    def build(self, site: Site) -> Any:
        """Return the surface, placed as the table says."""
        given = self.arguments(site)
        shape = {name: given[name] for name in given.keys() - PlacedTable.model_fields}
        surface = type(self).noun(**shape)
        if (self.rotation, self.translation) == (NO_TURN, ORIGIN):
            return surface
        return surface.placed(self.rotation, self.translation)


class MeshTable(PlacedTable):
    """A closed mesh from a file."""

    kind: Literal["mesh"]
    file: Annotated[
        Path,
        Field(description="the path of a mesh, relative to the folder of the file that names it"),
    ]
    scale: Positive | None = None
    crease_angle: CreaseAngle | None = None
    reach: NotNegative | None = None

    def arguments(self, site: Site) -> dict[str, Any]:
        """Keys of the table, and who is told of the progress."""
        return super().arguments(site) | {"progress": site.progress}

    def build(self, site: Site) -> Any:
        """Return the surface; raise ValueError also if a mesh library is missing."""
        try:
            return super().build(site)
        except (ValueError, ImportError) as error:
            raise ValueError(f"file = {str(self.file)!r}: {error}") from error

    @staticmethod
    def noun(file: Path, **options: Any) -> surfaces.Mesh:
        """Load the mesh."""
        return surfaces.Mesh.load(file, **options)


_EXPONENTS = "two numbers greater than 0 and at most 2"
_PARTS = "a list of at least one object, each a table with its own kind"
_TYPES = {
    **dict.fromkeys("abh", Finite),
    **dict.fromkeys(("center", "point", "normal", "axis"), Vector),
    **dict.fromkeys(("radius", "length", "height", "major_radius", "minor_radius"), Positive),
    **dict.fromkeys(("semi_axes", "half_extents"), Lengths),
    "exponents": Annotated[tuple[Exponent, ...], several(2, _EXPONENTS)],
    "parts": Annotated[list["ObjectTable"], Field(min_length=1, description=_PARTS)],  # type: ignore[valid-type]
    "surface": "ObjectTable",
}
_KINDS = {
    "elliptic_paraboloid": surfaces.EllipticParaboloid,
    "sphere": surfaces.Sphere,
    "ellipsoid": surfaces.Ellipsoid,
    "elliptic_cylinder": surfaces.EllipticCylinder,
    "plane": surfaces.Plane,
    "box": surfaces.Box,
    "cylinder": surfaces.Cylinder,
    "capsule": surfaces.Capsule,
    "cone": surfaces.Cone,
    "torus": surfaces.Torus,
    "superquadric": surfaces.Superquadric,
    "mesh": MeshTable,
    "union": surfaces.Union,
    "offset": surfaces.Offset,
}
# An infinite cylinder has two semi-axes.
_TWO = Annotated[tuple[Positive, ...], several(2, "two numbers greater than 0")]
_OTHER = {"elliptic_cylinder": {"semi_axes": _TWO}}
_TABLES = [
    noun if noun is MeshTable else table_of(noun, _TYPES | _OTHER.get(kind, {}), kind, PlacedTable)
    for kind, noun in _KINDS.items()
]
ObjectTable = one_of(_TABLES)
for _table in _TABLES:
    _table.model_rebuild(_types_namespace={"ObjectTable": ObjectTable})
