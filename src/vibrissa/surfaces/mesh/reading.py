"""Triangles from files, read with trimesh."""

from pathlib import Path

import numpy as np

from vibrissa.geometry.checks import positive
from vibrissa.surfaces.mesh.libraries import Faces, Vertices, library

_UNITLESS = (".stl", ".obj", ".ply")
FORMATS = (*_UNITLESS, ".gltf", ".glb")
"""Suffixes of files that can be read; glTF is in metres, the others have no unit."""


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
    try:
        mesh = trimesh.load_mesh(file, file_type=suffix[1:], process=False, skip_materials=True)
        vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # whatever its parsers raise on a damaged file
        reason = " ".join(str(error).splitlines()) or type(error).__name__
        raise ValueError(f"{file}: not a readable {kind} file, or cut short ({reason})") from error
    # Of several solids in one text file, trimesh takes the complete ones.
    in_text = file.read_bytes().lower().count(b"facet normal") if suffix == ".stl" else 0
    if not len(faces) or len(faces) < in_text:
        raise ValueError(f"{file}: no triangles, or cut short; allowed is a closed mesh")
    return vertices * factor, faces
