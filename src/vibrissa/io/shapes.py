"""Fitted surfaces as files: meshes, comparisons with a model, and voxels."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from vibrissa.files import InputError
from vibrissa.io.clouds import write_polydata
from vibrissa.io.contacts import checked_output, written
from vibrissa.io.fitted import comments_of, elements_of
from vibrissa.shape import Comparison, Occupancy, Shape, ShapeMesh

SHAPE_SUFFIXES = (".ply", ".vtp", ".stl", ".glb")
OCCUPANCY_SUFFIXES = (".npz", ".mcap")
_SAID = "surface through contacts of an elastic rod"
Fields = dict[str, Shaped[np.ndarray, "v"]]


def write_shape(
    path: str | Path, shape: Shape | ShapeMesh | Comparison, *, fitted: Shape | None = None
) -> Path:
    """Write the mesh of a fitted surface, or of its comparison with a model, in the contacts' unit
    of length.

    Parameters
    ----------
    path
        PLY or VTK's `.vtp` (ParaView): vertices with normal and fields, in double precision; binary
        glTF `.glb`: with the fields, in single precision; STL: triangles only, in single precision.
    shape
        A fitted surface stands for its mesh, `fitted` by it. A mesh has the fields `deviation` and
        `seen`. A comparison has `distance`, its `deviation`, `p_value` and `significant` besides,
        and colours, except in STL: blue where there is too little material, red where there is too
        much, grey where that is not significant.
    fitted
        The surface behind it: PLY then holds its contacts too, from which `read_shape` fits it
        again; the other formats do not.

    Raises
    ------
    InputError
        If the suffix is not one of these, the mesh has no triangle, the file cannot be written, or
        trimesh is not installed, which STL and glTF need.
    """
    file = checked_output(path, SHAPE_SUFFIXES)
    if isinstance(shape, Shape):
        return write_shape(file, shape.mesh(), fitted=shape)
    mesh = shape.mesh if isinstance(shape, Comparison) else shape
    if not len(mesh.faces):
        raise InputError(f"{file}: the mesh has no triangle; allowed is a surface that was touched")
    writers: dict[str, Callable[[], None]] = {
        ".ply": lambda: _write_ply(file, shape, fitted),
        ".vtp": lambda: _write_vtp(file, shape),
        ".glb": lambda: _write_other(file, shape),
        ".stl": lambda: _write_other(file, shape),
    }
    return written(file, writers[file.suffix.lower()])


def _parts(shape: ShapeMesh | Comparison) -> tuple[ShapeMesh, Fields, np.ndarray | None]:
    """Mesh, fields and colours (v, 3)."""
    if isinstance(shape, ShapeMesh):
        return shape, {"deviation": shape.deviation, "seen": shape.seen.astype(np.uint8)}, None
    fields: Fields = {
        "distance": shape.distance,
        "deviation": shape.deviation,
        "p_value": shape.p_value,
        "significant": shape.significant.astype(np.uint8),
        "seen": shape.mesh.seen.astype(np.uint8),
    }
    return shape.mesh, fields, shape.colours()


def _write_ply(file: Path, shape: ShapeMesh | Comparison, fitted: Shape | None) -> None:
    from plyfile import PlyData, PlyElement  # noqa: PLC0415

    mesh, fields, colours = _parts(shape)
    places = np.column_stack([mesh.vertices, mesh.normal])
    columns = dict(zip(("x", "y", "z", "nx", "ny", "nz"), places.T, strict=True)) | fields
    if colours is not None:
        columns |= dict(zip(("red", "green", "blue"), colours.T, strict=True))
    vertices = np.zeros(len(places), [(name, part.dtype) for name, part in columns.items()])
    for name, column in columns.items():
        vertices[name] = column
    faces = np.zeros(len(mesh.faces), [("vertex_indices", "<i4", (3,))])
    faces["vertex_indices"] = mesh.faces
    elements = [PlyElement.describe(vertices, "vertex"), PlyElement.describe(faces, "face")]
    comments = [_SAID, "deviation: standard deviation"]
    if isinstance(shape, Comparison):
        comments.append("distance: from the model, positive where there is too much material")
    if fitted is not None:
        elements += elements_of(fitted)
        comments += comments_of(fitted)
    PlyData(elements, byte_order="<", comments=comments).write(str(file))


def _write_vtp(file: Path, shape: ShapeMesh | Comparison) -> None:
    mesh, fields, colours = _parts(shape)
    shown = "deviation" if colours is None else "distance"
    arrays = {"normal": mesh.normal, **fields}
    if colours is not None:
        arrays["colour"] = colours
    write_polydata(
        file,
        mesh.vertices,
        arrays,
        mesh.faces,
        active={"Normals": "normal", "Scalars": shown},
        comment=_SAID,
    )


def _write_other(file: Path, shape: ShapeMesh | Comparison) -> None:
    mesh, fields, colours = _parts(shape)
    solid = mesh.to_trimesh()
    if colours is not None:
        solid.visual.vertex_colors = colours
    # As glTF wants names and types of fields that are not its own.
    solid.vertex_attributes = {
        f"_{name.upper()}": np.asarray(values, dtype=np.float32) for name, values in fields.items()
    }
    solid.export(str(file))


def write_occupancy(path: str | Path, occupancy: Occupancy, *, height: float | None = None) -> Path:
    """Write the voxels of a fitted surface, in the contacts' unit of length.

    Parameters
    ----------
    path
        NumPy's `.npz`, with `origin`, `spacing` and `values` as in `Occupancy`; or MCAP, as ROS 2
        plays it: one horizontal layer as `nav_msgs/msg/OccupancyGrid` on `/vibrissa/occupancy`
        (percent, -1 where unknown), and the middles of all voxels that are filled rather than not
        as `sensor_msgs/msg/PointCloud2` with their `probability` on `/vibrissa/voxels`; both in
        the frame `world`.
    occupancy
        From `Shape.occupancy`.
    height
        z of the layer in MCAP, taken through the nearest voxels; by default half-way up.

    Raises
    ------
    ValueError
        If the height is outside the lattice.
    InputError
        If the suffix is not one of these, the file cannot be written, or the libraries of
        `vibrissa[live]` are not installed, which MCAP needs.
    """
    file = checked_output(path, OCCUPANCY_SUFFIXES)
    layer = _layer(occupancy, height)
    if file.suffix.lower() == ".mcap":
        return written(file, lambda: _write_mcap(file, occupancy, layer))
    return written(file, lambda: _write_npz(file, occupancy))


def _layer(occupancy: Occupancy, height: float | None) -> int:
    """Number of the layer at a height."""
    count = occupancy.values.shape[2]
    if height is None:
        return count // 2
    low, high = occupancy.origin[2] + occupancy.spacing * np.array([-0.5, count - 0.5])
    if not low <= height <= high:
        raise ValueError(f"height = {height!r}; allowed is {low:.4g} to {high:.4g}")
    return min(int((height - low) / occupancy.spacing), count - 1)


def _write_npz(file: Path, occupancy: Occupancy) -> None:
    with file.open("wb") as stream:  # a name would be given another suffix unless in lower case
        np.savez_compressed(
            stream,
            origin=occupancy.origin,
            spacing=np.array(occupancy.spacing),
            values=occupancy.values,
        )


def _write_mcap(file: Path, occupancy: Occupancy, layer: int) -> None:
    from vibrissa.io.rosbag.voxels import write_voxels  # noqa: PLC0415

    write_voxels(file, occupancy, layer)
