"""Slip, step by step (mechanics.md, "Slip")."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.forward.slip import Slip, slip_along

N = 40


@pytest.fixture(scope="module")
def path() -> tuple[np.ndarray, ...]:
    """A contact point, arc length, contact tangent and plane normal that all vary along a trail."""
    u = np.linspace(0, 1, N)
    frames = Rotation.from_rotvec(np.stack([0.3 * u, 0.5 * np.sin(2 * u), u**2], axis=1))
    point = np.stack([u, 0.3 * u**2, 0.1 * np.cos(3 * u)], axis=1)
    return point, 1 - 0.2 * u**2, frames.apply([1, 0, 0]), frames.apply([0, 0, 1])


def slip_of(path: tuple[np.ndarray, ...]) -> Slip:
    return slip_along(*path)


def test_axial_slip_is_the_change_of_arc_length(path: tuple[np.ndarray, ...]) -> None:
    np.testing.assert_allclose(slip_of(path).axial[1:], np.diff(path[1]), rtol=0, atol=1e-16)


def test_parts_in_and_across_the_bending_plane_are_orthogonal(path: tuple[np.ndarray, ...]) -> None:
    slip, moved = slip_of(path), np.diff(path[0], axis=0)
    total = slip.longitudinal[1:] ** 2 + slip.lateral[1:] ** 2
    np.testing.assert_allclose(total, np.sum(moved**2, axis=1), rtol=1e-13)
    assert np.any(np.abs(slip.lateral[1:]) > 0.1 * np.abs(slip.longitudinal[1:]))


def test_lateral_slip_is_along_the_plane_normal(path: tuple[np.ndarray, ...]) -> None:
    point, _, _, normal = path
    across = normal[1:] + normal[:-1]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    expected = np.sum(np.diff(point, axis=0) * across, axis=1)
    np.testing.assert_allclose(slip_of(path).lateral[1:], expected, rtol=0, atol=1e-15)


def test_signs_say_along_the_rod_or_back() -> None:
    tangent, normal = np.tile([1.0, 0, 0], (3, 1)), np.tile([0, 0, 1.0], (3, 1))
    point = np.array([(0, 0, 0), (0.2, 0, 0.1), (0.1, 0, 0.4)])
    slip = slip_along(point, np.array([0.5, 0.5, 0.4]), tangent, normal)
    np.testing.assert_allclose(slip.longitudinal[1:], [0.2, -0.1])
    np.testing.assert_allclose(slip.lateral[1:], [0.1, 0.3])
    # The material point goes forward with the rod where the contact retreats along it: dP₁ − t ds₁.
    np.testing.assert_allclose(slip.sliding[1:], [(0.2, 0, 0.1), (0, 0, 0.3)], atol=1e-16)


def test_where_either_end_has_no_contact_there_is_no_slip(path: tuple[np.ndarray, ...]) -> None:
    point, arc_length, tangent, normal = (part.copy() for part in path)
    for part in (point, arc_length, tangent, normal):
        part[[0, 7]] = np.nan
    slip = slip_along(point, arc_length, tangent, normal)
    without = [0, 1, 7, 8]
    for figure in (slip.axial, slip.longitudinal, slip.lateral, slip.sliding[:, 0]):
        np.testing.assert_array_equal(np.flatnonzero(np.isnan(figure)), without)


def test_trails_do_not_slip_into_each_other(path: tuple[np.ndarray, ...]) -> None:
    both = slip_along(*(np.stack([part, part[::-1]]) for part in path))
    alone = slip_of(path)
    np.testing.assert_array_equal(both.lateral[0], alone.lateral)
    np.testing.assert_allclose(both.axial[1, 1:], -alone.axial[:0:-1], atol=1e-16)


def test_status_and_kind_are_told_in_words() -> None:
    """Every status says what to do in one sentence, OK says nothing is wrong."""
    texts = [status.text for status in vb.Status]
    assert len(set(texts)) == len(vb.Status)
    assert all(text.endswith(".") and "\n" not in text for text in texts)
    assert all(
        ";" in status.text or ":" in status.text or "," in status.text
        for status in vb.Status
        if status
    )
    assert [int(kind) for kind in vb.ContactKind] == [0, 1, 2]
