"""Clamp paths."""

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import vibrissa as vb

LINE = vb.Trail.line(start=(1.2, 0.2, 0), stop=(-1.2, 0.2, 0.1), count=5, axis=(0.0, 3.0, 4.0))


def test_line_is_straight_and_equally_spaced() -> None:
    np.testing.assert_allclose(
        LINE.position[[0, 2, 4]], [(1.2, 0.2, 0), (0, 0.2, 0.05), (-1.2, 0.2, 0.1)], atol=1e-15
    )
    np.testing.assert_allclose(np.diff(LINE.position, axis=0), [(-0.6, 0, 0.025)] * 4, atol=1e-15)
    np.testing.assert_allclose(LINE.axis, [(0, 0.6, 0.8)] * 5, atol=1e-15)
    np.testing.assert_allclose(LINE.parameter, [0, 0.25, 0.5, 0.75, 1], atol=1e-15)


def test_without_an_axis_the_rod_leaves_along_z() -> None:
    trail = vb.Trail.line(start=(0, 0, 0), stop=(1, 0, 0), count=2)
    np.testing.assert_array_equal(trail.axis, [(0, 0, 1)] * 2)
    np.testing.assert_array_equal(trail.orientation, [(0, 0, 0, 1)] * 2)


def test_raster_moves_the_line_on() -> None:
    raster = vb.Trail.raster(
        start=(1, 0, 0), stop=(0, 0, 0), count=4, step=(0, 0.1, 0.2), trails=3, axis=(0, 1.0, 0)
    )
    assert raster.shape == (3, 4)
    np.testing.assert_allclose(
        raster.position[2] - raster.position[0], [(0, 0.2, 0.4)] * 4, atol=1e-15
    )
    np.testing.assert_allclose(raster.axis, np.broadcast_to([0, 1.0, 0], (3, 4, 3)), atol=1e-15)


def test_stack_keeps_every_pose() -> None:
    other = vb.Trail(LINE.position + 1, Rotation.from_rotvec(np.outer(np.arange(5), [0.1, 0, 0])))
    stacked = vb.Trail.stack([LINE, other, vb.Trail.stack([LINE, other])])
    assert stacked.shape == (4, 5)
    for lane, trail in enumerate((LINE, other, LINE, other)):
        np.testing.assert_array_equal(stacked.position[lane], trail.position)
        np.testing.assert_allclose(stacked.orientation[lane], trail.orientation, rtol=0, atol=1e-15)


def test_parameter_is_the_share_of_the_path_or_of_the_turn() -> None:
    uneven = vb.Trail([(0, 0, 0), (1, 0, 0), (1, 3, 0)])
    np.testing.assert_allclose(uneven.parameter, [0, 0.25, 1])
    turning = vb.Trail(
        np.zeros((3, 3)), Rotation.from_rotvec([(0, 0, 0), (0.1, 0, 0), (0.2, 0, 0)])
    )
    np.testing.assert_allclose(turning.parameter, [0, 0.5, 1])
    np.testing.assert_allclose(turning.axis[:, 1], -np.sin([0, 0.1, 0.2]), atol=1e-15)


@given(
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 1e-3)
)
def test_orientation_is_normalised(quaternion: list[float]) -> None:
    trail = vb.Trail(np.zeros((2, 3)), np.array(quaternion))
    np.testing.assert_allclose(np.linalg.norm(trail.orientation, axis=-1), 1, rtol=1e-15)
    np.testing.assert_allclose(
        trail.axis[0], Rotation.from_quat(quaternion).apply([0, 0, 1]), rtol=0, atol=1e-14
    )


def test_cannot_be_changed_behind_its_back() -> None:
    points = np.zeros((2, 3))
    trail = vb.Trail(points)
    points[0, 0] = 7
    assert trail.position[0, 0] == 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        trail.position = points  # type: ignore[misc]


ZERO_SECOND = np.array([(0, 0, 0, 1), (0, 0, 0, 0)], dtype=float)
BAD = {
    "empty": (
        lambda: vb.Trail(np.zeros((0, 3))),
        "position has shape (0, 3): an empty trail; allowed is at least one",
    ),
    "a point": (lambda: vb.Trail(np.zeros(3)), "position has shape (3,); allowed is (n, 3)"),
    "plane points": (
        lambda: vb.Trail(np.zeros((4, 2))),
        "position has shape (4, 2); allowed is (…, 3)",
    ),
    "not finite": (
        lambda: vb.Trail([(0, 0, 0), (0, np.nan, 0)]),
        "position[1, 1] = nan; allowed are finite numbers",
    ),
    "zero norm": (
        lambda: vb.Trail(np.zeros((2, 3)), ZERO_SECOND),
        "orientation[1] = [0.0, 0.0, 0.0, 0.0] has zero norm; allowed is any quaternion",
    ),
    "three numbers": (
        lambda: vb.Trail(np.zeros((2, 3)), np.ones(3)),
        "orientation has shape (3,); allowed is (…, 4)",
    ),
    "too many": (
        lambda: vb.Trail(np.zeros((2, 3)), np.ones((3, 4))),
        "orientation has shape (3, 4); allowed is (4,) or (2, 4), as position has",
    ),
    "no axis": (
        lambda: vb.Trail.line(start=(0, 0, 0), stop=(1, 0, 0), count=2, axis=(0, 0, 0)),
        "axis = [0.0, 0.0, 0.0]; allowed is any 3-vector of non-zero length",
    ),
    "start": (
        lambda: vb.Trail.line(start=(np.inf, 0, 0), stop=(1, 0, 0), count=2),
        "start[0] = inf; allowed",
    ),
    "stop": (
        lambda: vb.Trail.line(start=(0, 0, 0), stop=np.zeros(2), count=2),
        "stop has shape (2,); allowed is (3,)",
    ),
    "count": (
        lambda: vb.Trail.line(start=(0, 0, 0), stop=(1, 0, 0), count=0),
        "count = 0; allowed is a whole number of at least 1",
    ),
    "half a count": (
        lambda: vb.Trail.line(start=(0, 0, 0), stop=(1, 0, 0), count=2.5),
        "count = 2.5; allowed is a whole number of at least 1",
    ),
    "no count": (
        lambda: vb.Trail.line(start=(0, 0, 0), stop=(1, 0, 0), count=np.nan),
        "count = nan; allowed is a whole number of at least 1",
    ),
    "endless count": (
        lambda: vb.Trail.line(start=(0, 0, 0), stop=(1, 0, 0), count=np.inf),
        "count = inf; allowed is a whole number of at least 1",
    ),
    "words": (
        lambda: vb.Trail([("a", 0, 0)]),
        "position = [('a', 0, 0)]; allowed is an array of numbers",
    ),
    "trails": (
        lambda: vb.Trail.raster(
            start=(0, 0, 0), stop=(1, 0, 0), count=2, step=(0, 1, 0), trails=-1
        ),
        "trails = -1; allowed is a whole number of at least 1",
    ),
    "no trails": (lambda: vb.Trail.stack([]), "trails is empty; allowed is at least one trail"),
    "lengths": (
        lambda: vb.Trail.stack([LINE, vb.Trail(np.zeros((2, 3)))]),
        "trails have [2, 5] positions; allowed are equal lengths",
    ),
}


@pytest.mark.usefixtures("no_shape_checks")
@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_named(what: str) -> None:
    build, message = BAD[what]
    with pytest.raises(ValueError, match=re.escape(message)):
        build()
