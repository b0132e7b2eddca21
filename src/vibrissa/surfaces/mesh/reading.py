"""Triangles from files, through trimesh."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from vibrissa.geometry.checks import positive
from vibrissa.surfaces.mesh.libraries import library

_UNITLESS = (".stl", ".obj", ".ply")
_METRES = (".gltf", ".glb")
FORMATS = (*_UNITLESS, *_METRES)


def read(
    path: str | Path, scale: float | None
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
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
    if suffix not in FORMATS:
        raise ValueError(f"{file}: suffix {file.suffix!r}; allowed are {', '.join(FORMATS)}")
    if scale is None and suffix in _UNITLESS:
        raise ValueError(
            f"{file}: scale is missing; {suffix[1:].upper()} has no unit, so give the length of the file's unit, such as 1e-3 for millimetres"
        )
    factor = 1.0 if scale is None else positive(scale, "scale")
    if not file.is_file():
        raise ValueError(f"{file}: cannot be read; allowed is a file")
    vertices, faces = _triangles(file, suffix)
    if not len(faces):
        raise ValueError(f"{file}: no triangles; allowed is a closed mesh")
    return vertices * factor, faces


def _triangles(file: Path, suffix: str) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    trimesh = library("trimesh")
    if suffix == ".stl":
        _complete_stl(file)
    try:
        mesh = trimesh.load_mesh(file, file_type=suffix[1:], process=False, skip_materials=True)
        return np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3), np.array(
            mesh.faces, dtype=np.int64
        ).reshape(-1, 3)
    except Exception as error:  # whatever its parsers raise on a damaged file
        reason = " ".join(str(error).splitlines()) or type(error).__name__
        raise ValueError(
            f"{file}: not a readable {suffix[1:].upper()} file, or cut short ({reason})"
        ) from error


def _complete_stl(file: Path) -> None:
    """A file in binary says how many triangles it holds, one in ASCII how it ends: trimesh would
    take a part for the whole.
    """
    content = file.read_bytes()
    if content.lstrip()[:5].lower() == b"solid" and b"facet" in content[:1000]:
        if b"endsolid" not in content[-1000:].lower():
            raise ValueError(
                f"{file}: cut short (no endsolid at its end); allowed is a whole STL file"
            )
        return
    if len(content) < 84:
        raise ValueError(
            f"{file}: {len(content)} bytes; allowed is an STL file, of at least 84 bytes in binary"
        )
    count = int.from_bytes(content[80:84], "little")
    if len(content) != 84 + 50 * count:
        raise ValueError(
            f"{file}: {len(content)} bytes where {84 + 50 * count} belong to the {count} triangles it says; it is cut short or no STL file"
        )
