"""Triangles from files, through trimesh."""

from pathlib import Path

import numpy as np

from vibrissa.geometry.checks import positive
from vibrissa.surfaces.mesh.libraries import Faces, Vertices, library

_UNITLESS = (".stl", ".obj", ".ply")
FORMATS = (*_UNITLESS, ".gltf", ".glb")
"""Suffixes of files that can be read; glTF is in metres, the others have no unit."""

# STL in binary: a header of 80 bytes and a count of 4, then 50 bytes a triangle.
_HEADER, _COUNT, _TRIANGLE = 80, 4, 50


def read(path: str | Path, scale: float | None) -> tuple[Vertices, Faces]:
    """Vertices, times `scale`, and faces of a file.

    Raises
    ------
    ValueError
        If the suffix is none of STL, OBJ, PLY, glTF and GLB, the file cannot be read, is damaged or
        holds no triangles, or `scale` is missing where the format has no unit.
    ImportError
        If trimesh is not installed.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    kind = suffix[1:].upper()
    if suffix not in FORMATS:
        raise ValueError(f"{file}: suffix {file.suffix!r}; allowed are {', '.join(FORMATS)}")
    if scale is None and suffix in _UNITLESS:
        raise ValueError(
            f"{file}: scale is missing; {kind} has no unit, so give the length of the file's unit, "
            "such as 1e-3 for millimetres"
        )
    factor = 1.0 if scale is None else positive(scale, "scale")
    if not file.is_file():
        raise ValueError(f"{file}: cannot be read; allowed is a file")
    trimesh = library("trimesh")
    if suffix == ".stl":
        _refuse_part_of_stl(file)
    try:
        mesh = trimesh.load_mesh(file, file_type=suffix[1:], process=False, skip_materials=True)
        vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # whatever its parsers raise on a damaged file
        reason = " ".join(str(error).splitlines()) or type(error).__name__
        raise ValueError(f"{file}: not a readable {kind} file, or cut short ({reason})") from error
    if not len(faces):
        raise ValueError(f"{file}: no triangles; allowed is a closed mesh")
    return vertices * factor, faces


def _refuse_part_of_stl(file: Path) -> None:
    """Raise ValueError for a file that is cut short, which trimesh would take for a whole one: in
    binary it says how many triangles it holds, in ASCII how it ends.
    """
    content = file.read_bytes()
    if content.lstrip()[:5].lower() == b"solid" and b"facet" in content[:1000]:
        if b"endsolid" not in content[-1000:].lower():
            raise ValueError(
                f"{file}: cut short (no endsolid at its end); allowed is a whole STL file"
            )
        return
    start = _HEADER + _COUNT
    count = int.from_bytes(content[_HEADER:start], "little")
    expected = start + _TRIANGLE * count
    if len(content) != expected:
        raise ValueError(
            f"{file}: {len(content)} bytes where {expected} belong to the {count} triangles it "
            "says; it is cut short or no STL file"
        )
