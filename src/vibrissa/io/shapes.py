"""Meshes of fitted surfaces, in the format that the suffix says."""

from pathlib import Path

import numpy as np

from vibrissa.files import InputError
from vibrissa.io.contacts import checked_output, written
from vibrissa.shape import ShapeMesh

SHAPE_SUFFIXES = (".ply", ".stl", ".glb")


def write_shape(path: str | Path, mesh: ShapeMesh) -> Path:
    """Write the mesh of a fitted surface.

    PLY (vertices with normal, `deviation` and `seen`, in double precision), STL (triangles only, in
    single precision) or binary glTF (with both fields, in single precision), in the contacts' unit
    of length.

    Raises
    ------
    InputError
        If the suffix is not one of these, the mesh has no triangle, the file cannot be written, or
        trimesh is not installed, which all but PLY need.
    """
    file = checked_output(path, SHAPE_SUFFIXES)
    if not len(mesh.faces):
        raise InputError(f"{file}: the mesh has no triangle; allowed is a surface that was touched")
    write = _write_ply if file.suffix.lower() == ".ply" else _write_other
    return written(file, lambda: write(file, mesh))


def _write_ply(file: Path, mesh: ShapeMesh) -> None:
    from plyfile import PlyData, PlyElement  # noqa: PLC0415

    names = ("x", "y", "z", "nx", "ny", "nz", "deviation")
    vertices = np.zeros(len(mesh.vertices), [(name, "<f8") for name in names] + [("seen", "u1")])
    columns = np.column_stack([mesh.vertices, mesh.normal, mesh.deviation])
    for name, column in zip(names, columns.T, strict=True):
        vertices[name] = column
    vertices["seen"] = mesh.seen
    faces = np.zeros(len(mesh.faces), [("vertex_indices", "<i4", (3,))])
    faces["vertex_indices"] = mesh.faces
    elements = [PlyElement.describe(vertices, "vertex"), PlyElement.describe(faces, "face")]
    comments = ["surface through contacts of an elastic rod", "deviation: standard deviation"]
    PlyData(elements, byte_order="<", comments=comments).write(str(file))


def _write_other(file: Path, mesh: ShapeMesh) -> None:
    solid = mesh.to_trimesh()
    # As glTF wants names and types of fields that are not its own.
    solid.vertex_attributes = {
        f"_{name.upper()}": np.asarray(values, dtype=np.float32)
        for name, values in solid.vertex_attributes.items()
    }
    solid.export(str(file))
