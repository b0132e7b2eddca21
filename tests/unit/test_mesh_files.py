"""Meshes from files and arrays: formats and scales, what is mended, and errors that count what is
not.
"""

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from vibrissa.surfaces import Mesh

Arrays = tuple[np.ndarray, np.ndarray]


def octahedron() -> Arrays:
    mesh = trimesh.creation.icosahedron().subdivide()
    return np.array(mesh.vertices), np.array(mesh.faces)


POINTS = np.random.default_rng(1).normal(size=(50, 3))


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
def test_every_format_gives_the_same_solid(suffix: str, tmp_path: Path) -> None:
    vertices, faces = octahedron()
    file = tmp_path / f"solid.{suffix}"
    trimesh.Trimesh(1000 * vertices, faces, process=False).export(file)
    read = Mesh.load(file, scale=1e-3)
    near = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
    np.testing.assert_allclose(
        read.levels(near), Mesh(vertices, faces).levels(near), rtol=0, atol=1e-6
    )


def test_a_mesh_prints_on_one_line() -> None:
    vertices, faces = octahedron()
    mesh = Mesh(vertices / np.ptp(vertices, axis=0) * [2, 3, 0.5], faces)
    assert repr(mesh) == "Mesh of 80 triangles, 2 × 3 × 0.5, watertight"
    assert len(repr(mesh.placed(translation=(0, 0, 1))).splitlines()) == 1


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_a_format_without_units_needs_a_scale(suffix: str, tmp_path: Path) -> None:
    vertices, faces = octahedron()
    file = tmp_path / f"solid.{suffix}"
    trimesh.Trimesh(vertices, faces).export(file)
    with pytest.raises(ValueError, match=r"scale is missing.*1e-3 for millimetres"):
        Mesh.load(file)
    for scale in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="scale"):
            Mesh.load(file, scale=scale)


def test_a_file_cut_short_is_told_apart(tmp_path: Path) -> None:
    vertices, faces = octahedron()
    for suffix in ("stl", "ply", "glb"):
        whole, part = tmp_path / f"whole.{suffix}", tmp_path / f"part.{suffix}"
        trimesh.Trimesh(vertices, faces).export(whole)
        content = whole.read_bytes()
        for share in (0.0, 0.3, 0.6, 0.95):
            part.write_bytes(content[: int(share * len(content))])
            with pytest.raises(ValueError, match=r"part\.") as caught:
                Mesh.load(part, scale=1.0)
            assert "\n" not in str(caught.value)


def test_a_text_of_two_solids_cut_in_the_second_is_told_apart(tmp_path: Path) -> None:
    vertices, faces = octahedron()
    first, second = (
        trimesh.Trimesh(vertices + shift, faces).export(file_type="stl_ascii") for shift in (0, 9)
    )
    file = tmp_path / "two.stl"
    file.write_text(f"{first}\n{second}")
    assert len(Mesh.load(file, scale=1.0).source.faces) == 2 * len(faces)
    for share in (0.3, 0.6, 0.9):
        file.write_text(f"{first}\n{second[: int(share * len(second))]}")
        with pytest.raises(ValueError, match=r"two\.stl: .*cut short"):
            Mesh.load(file, scale=1.0)


def twice(v: np.ndarray, f: np.ndarray) -> Arrays:
    """Vertices of their own for each triangle, as in STL."""
    return v[f].reshape(-1, 3), np.arange(3 * len(f)).reshape(-1, 3)


def inside_out(v: np.ndarray, f: np.ndarray) -> Arrays:
    return v, f[:, ::-1]


def one_turned(v: np.ndarray, f: np.ndarray) -> Arrays:
    turned = f.copy()
    turned[7] = turned[7][::-1]
    return v, turned


def one_missing(v: np.ndarray, f: np.ndarray) -> Arrays:
    return v, f[1:]


def two_missing(v: np.ndarray, f: np.ndarray) -> Arrays:
    beside = np.flatnonzero([len(set(f[0]) & set(row)) == 2 for row in f])[0]
    return v, np.delete(f, [0, beside], axis=0)


def two_holes_in_a_vertex(v: np.ndarray, f: np.ndarray) -> Arrays:
    around = np.flatnonzero(np.any(f == f[0, 0], axis=1))
    apart = next(row for row in around if len(set(f[0]) & set(f[row])) == 1)
    return v, np.delete(f, [0, apart], axis=0)


def one_more(v: np.ndarray, f: np.ndarray) -> Arrays:
    """A triangle with two corners in one, one that is there already, and a vertex of none."""
    return np.concatenate([v, [[5.0, 5.0, 5.0]]]), np.concatenate([f, f[3:4], [[0, 0, 1]]])


def one_flat(v: np.ndarray, f: np.ndarray) -> Arrays:
    """A triangle halved, its neighbour not: between them one whose corners lie on a line."""
    a, b, c = f[0]
    halves = [[a, len(v), c], [len(v), b, c], [a, b, len(v)]]
    return np.concatenate([v, [(v[a] + v[b]) / 2]]), np.concatenate([f[1:], halves])


@pytest.mark.parametrize(
    ("damaged", "said"),
    [
        (one_flat, "1 degenerate faces"),
        (twice, "merged vertices"),
        (inside_out, "80 flipped faces"),
        (one_turned, "1 flipped faces"),
        (one_missing, "1 filled holes"),
        (two_missing, "1 filled holes"),
        (two_holes_in_a_vertex, "2 filled holes"),
        (one_more, "1 degenerate faces, 1 duplicate faces"),
    ],
)
def test_what_can_be_mended_is_and_said(
    damaged: Callable[..., Arrays], said: str, caplog: pytest.LogCaptureFixture
) -> None:
    vertices, faces = octahedron()
    sound = Mesh(vertices, faces)
    assert not sound.repairs
    with caplog.at_level(logging.WARNING):
        mended = Mesh(*damaged(vertices, faces))
    assert said in str(mended.repairs)
    # Every STL has its vertices several times.
    assert (said in caplog.text) == (said != "merged vertices")
    far = POINTS[np.linalg.norm(POINTS, axis=1) > 1.2]
    np.testing.assert_allclose(mended.levels(far), sound.levels(far), rtol=0, atol=0.08)
    assert mended.levels(np.zeros(3)) < 0


def half(v: np.ndarray, f: np.ndarray) -> Arrays:
    return v, f[v[f].mean(axis=1)[:, 2] > 0]


def three_on_an_edge(v: np.ndarray, f: np.ndarray) -> Arrays:
    return np.concatenate([v, [[0.0, 0.0, 3.0]]]), np.concatenate([f, [[f[0, 0], f[0, 1], len(v)]]])


def crossing(v: np.ndarray, f: np.ndarray) -> Arrays:
    return np.concatenate([v, v + [0.7, 0.1, 0.2]]), np.concatenate([f, f + len(v)])


def not_finite(v: np.ndarray, f: np.ndarray) -> Arrays:
    return np.where(np.arange(len(v))[:, None] < 3, np.nan, v), f


@pytest.mark.parametrize(
    ("damaged", "said"),
    [
        (half, r"\d+ open edges in 1 holes"),
        (three_on_an_edge, r"1 edges with more than two triangles"),
        (crossing, r"\d+ pairs of triangles cross"),
        (not_finite, r"vertices\[0, 0\] = nan; allowed are finite numbers"),
        (lambda v, f: (v, f + 1), r"\d+ indices lie outside 0 … 41"),
        (lambda v, f: (v[:, :2], f), r"vertices has shape \(42, 2\)"),
        (lambda v, f: (v, f[:0]), r"42 vertices and 0 faces"),
    ],
)
def test_what_cannot_be_mended_is_counted(damaged: Callable[..., Arrays], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Mesh(*damaged(*octahedron()))


def test_a_cavity_is_a_cavity() -> None:
    """A part inside another, wound either way, is hollow."""
    vertices, faces = octahedron()
    for inner in (faces, faces[:, ::-1]):
        shell = Mesh(
            np.concatenate([vertices, 0.5 * vertices]),
            np.concatenate([faces, inner + len(vertices)]),
        )
        assert shell.levels(np.zeros(3)) > 0
        assert shell.levels(np.array([0.7, 0.0, 0.0])) < 0
        assert shell.levels(np.array([1.5, 0.0, 0.0])) > 0
