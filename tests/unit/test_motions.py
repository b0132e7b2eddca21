"""Motions of the clamp: arcs, whisking, splines, poses of robots."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.io import InputError

AXIS = np.array([1.0, 2.0, 2.0]) / 3
CENTER = np.array([0.1, -0.2, 0.3])
START = np.array([1.0, 0.5, 0.2])
TURN = Rotation.from_rotvec([0.3, -0.2, 0.7])
angles = st.floats(-3.0, 3.0).filter(lambda angle: abs(angle) > 1e-3)


def motion(angle: float) -> Rotation:
    return Rotation.from_rotvec(angle * AXIS)


def same_turns(trail: vb.Trail, turns: Rotation) -> None:
    """To rounding, whatever the sign of the quaternions."""
    off = Rotation.from_quat(trail.orientation) * turns.inv()
    np.testing.assert_allclose(off.magnitude(), 0, atol=1e-14)


@given(angles)
def test_an_arc_goes_round_its_centre(angle: float) -> None:
    trail = vb.Trail.arc(center=CENTER, axis=3 * AXIS, start=START, angle=angle, count=7)
    for share, point in zip(np.linspace(0, 1, 7), trail.position, strict=True):
        np.testing.assert_allclose(
            point, CENTER + motion(share * angle).apply(START - CENTER), rtol=0, atol=1e-14
        )
    np.testing.assert_allclose(trail.parameter, np.linspace(0, 1, 7), atol=1e-12)
    np.testing.assert_array_equal(trail.orientation, [(0, 0, 0, 1)] * 7)


def test_along_an_arc_the_clamp_keeps_its_orientation_or_turns() -> None:
    arc = {
        "center": CENTER,
        "axis": AXIS,
        "start": START,
        "angle": 2.0,
        "count": 5,
        "orientation": TURN,
    }
    kept, turning = vb.Trail.arc(**arc), vb.Trail.arc(**arc, turning=True)
    np.testing.assert_array_equal(kept.position, turning.position)
    same_turns(kept, Rotation.from_quat(np.tile(TURN.as_quat(), (5, 1))))
    same_turns(turning, Rotation.from_rotvec(np.outer(np.linspace(0, 2, 5), AXIS)) * TURN)
    # To the centre, the rod's direction is the same all along.
    radial = np.sum(turning.axis * (CENTER - turning.position), axis=-1)
    np.testing.assert_allclose(radial, radial[0], rtol=0, atol=1e-14)


def test_a_quarter_of_a_circle_in_numbers() -> None:
    trail = vb.Trail.arc(
        center=(0, 0, 1),
        axis=(0, 0, 2),
        start=(2, 0, 0),
        angle=np.pi / 2,
        count=2,
        rod_axis=(-3, 0, 0),
        turning=True,
    )
    np.testing.assert_allclose(trail.position, [(2, 0, 0), (0, 2, 0)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(trail.axis, [(-1, 0, 0), (0, -1, 0)], rtol=0, atol=1e-15)


@given(angles, angles)
def test_whisking_turns_the_whole_clamp_about_the_pivot(start: float, stop: float) -> None:
    trail = vb.Trail.whisk(
        pivot=CENTER,
        axis=AXIS,
        position=START,
        start_angle=start,
        stop_angle=stop,
        count=6,
        orientation=TURN.as_quat(),
    )
    for angle, point in zip(np.linspace(start, stop, 6), trail.position, strict=True):
        np.testing.assert_allclose(
            point, CENTER + motion(angle).apply(START - CENTER), rtol=0, atol=1e-14
        )
    same_turns(trail, Rotation.from_rotvec(np.outer(np.linspace(start, stop, 6), AXIS)) * TURN)


def test_whisking_in_numbers() -> None:
    """A rod along +z at angle 0, turned about −y: protraction towards −x."""
    trail = vb.Trail.whisk(
        pivot=(0, 0, 0),
        axis=(0, -1, 0),
        position=(0, 0, 0.5),
        start_angle=0,
        stop_angle=np.pi / 2,
        count=2,
    )
    np.testing.assert_allclose(trail.position, [(0, 0, 0.5), (-0.5, 0, 0)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(trail.axis, [(0, 0, 1), (-1, 0, 0)], rtol=0, atol=1e-15)


@pytest.mark.parametrize("share", [0.0, 0.7, -1e-17])
def test_a_clamp_on_the_pivot_axis_only_turns(share: float) -> None:
    trail = vb.Trail.whisk(
        pivot=CENTER,
        axis=AXIS,
        position=CENTER + share * AXIS,
        start_angle=-0.4,
        stop_angle=0.4,
        count=9,
    )
    assert np.all(np.ptp(trail.position, axis=0) == 0)
    np.testing.assert_allclose(trail.parameter, np.linspace(0, 1, 9), atol=1e-15)


def test_more_than_a_turn() -> None:
    trail = vb.Trail.whisk(
        pivot=(0, 0, 0),
        axis=(0, 1, 0),
        position=(1, 0, 0),
        start_angle=0,
        stop_angle=4 * np.pi,
        count=9,
    )
    np.testing.assert_allclose(
        trail.position,
        [(1, 0, 0), (0, 0, -1), (-1, 0, 0), (0, 0, 1)] * 2 + [(1, 0, 0)],
        rtol=0,
        atol=1e-14,
    )


def test_poses_of_a_robot_as_matrices() -> None:
    turns = Rotation.from_rotvec(np.outer(np.linspace(-2, 2, 4), AXIS)) * TURN
    matrices = np.tile(np.eye(4), (4, 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = turns.as_matrix(), np.linspace(START, CENTER, 4)
    for poses in (matrices, list(matrices), matrices.tolist()):
        trail = vb.Trail.from_poses(poses)
        np.testing.assert_array_equal(trail.position, np.linspace(START, CENTER, 4))
        same_turns(trail, turns)
    # The rod leaves along the third column.
    np.testing.assert_allclose(trail.axis, matrices[:, :3, 2], rtol=0, atol=1e-14)
    several = vb.Trail.from_poses(np.stack([matrices, matrices[::-1]]))
    assert several.shape == (2, 4)
    np.testing.assert_allclose(several.axis[1], matrices[::-1, :3, 2], rtol=0, atol=1e-14)


def test_poses_of_a_robot_as_rotations_and_points() -> None:
    turns = Rotation.from_rotvec(np.outer(np.arange(3), AXIS))
    trail = vb.Trail.from_poses(turns, position=np.linspace(START, CENTER, 3))
    np.testing.assert_array_equal(trail.position, np.linspace(START, CENTER, 3))
    same_turns(trail, turns)


def test_rounded_matrices_are_taken() -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = np.round(TURN.as_matrix(), 4)
    trail = vb.Trail.from_poses([matrix])
    assert (Rotation.from_quat(trail.orientation[0]) * TURN.inv()).magnitude() < 1e-4


WAY = np.array([(0, 0, 0), (1, 0, 0), (1.5, 1, 0.2), (0.5, 1, 1)], dtype=float)


def walked(curve: CubicSpline, stop: float) -> float:
    return float(
        quad(
            lambda u: np.linalg.norm(curve(u, 1)),
            0,
            stop,
            epsabs=1e-12,
            epsrel=1e-12,
            limit=200,
            points=curve.x[1:-1],
        )[0]
    )


def test_a_spline_is_walked_at_constant_speed() -> None:
    """Against SciPy's quadrature of the same curve."""
    trail = vb.Trail.spline(WAY, 11)
    chords = np.linalg.norm(np.diff(WAY, axis=0), axis=1)
    curve = CubicSpline(np.append(0, np.cumsum(chords)), WAY)
    total = walked(curve, curve.x[-1])
    fine = np.linspace(0, curve.x[-1], 200_001)
    for k, point in enumerate(trail.position):
        nearest = fine[np.argmin(np.linalg.norm(curve(fine) - point, axis=1))]
        assert walked(curve, nearest) == pytest.approx(k * total / 10, abs=3e-5)
    np.testing.assert_allclose(trail.position[[0, -1]], WAY[[0, -1]], rtol=0, atol=1e-15)
    near = np.linalg.norm(vb.Trail.spline(WAY, 100_001).position[:, None] - WAY, axis=-1).min(
        axis=0
    )
    assert near.max() < 3e-5


def test_a_spline_through_a_circle_keeps_to_it() -> None:
    """Of fourth order in the distance of the way-points."""
    errors = []
    for points in (16, 32):
        angle = np.linspace(0, 2 * np.pi, points + 1)
        trail = vb.Trail.spline(np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), 500)
        inner = np.abs(np.arctan2(trail.position[:, 1], trail.position[:, 0])) > 0.8
        errors.append(np.abs(np.linalg.norm(trail.position[inner], axis=1) - 1).max())
        steps = np.linalg.norm(np.diff(trail.position, axis=0), axis=1)
        assert np.ptp(steps) < 1e-3 * steps.mean()
    assert 3.5 < np.log2(errors[0] / errors[1]) < 4.5


@pytest.mark.parametrize("points", [2, 3, 5])
def test_way_points_on_a_line_give_a_line(points: int) -> None:
    trail = vb.Trail.spline(
        START + np.sort(np.cos(np.arange(points)))[:, None] * AXIS, 9, rod_axis=(0, 1, 0)
    )
    line = vb.Trail.line(start=trail.position[0], stop=trail.position[-1], count=9, axis=(0, 1, 0))
    np.testing.assert_allclose(trail.position, line.position, rtol=0, atol=1e-13)
    np.testing.assert_allclose(trail.orientation, line.orientation, rtol=0, atol=1e-15)


def test_there_and_back_stops_at_the_turning_point() -> None:
    """The speed of the curve falls to zero there."""
    trail = vb.Trail.spline([(0, 0, 0), (1, 0, 0), (0, 0, 0)], 9)
    np.testing.assert_allclose(
        trail.position[:, 0], [0, 0.25, 0.5, 0.75, 1, 0.75, 0.5, 0.25, 0], rtol=0, atol=1e-12
    )


def test_along_a_spline_the_clamp_turns_from_way_point_to_way_point() -> None:
    turns = Rotation.from_rotvec(np.outer([0.0, 1.0, 2.0, 3.0], AXIS)) * TURN
    line = np.outer(np.arange(4), [0, 0, 1.0])
    for orientations in (turns, turns.as_quat() * [[1], [-1], [1], [-1]]):
        # Equal turns over equal distances: at a constant rate.
        same_turns(
            vb.Trail.spline(line, 7, orientations=orientations),
            Rotation.from_rotvec(np.outer(np.linspace(0, 3, 7), AXIS)) * TURN,
        )
    uneven = Rotation.from_rotvec(np.outer([0.0, 1.0, -0.5, 0.5], AXIS))
    fine = vb.Trail.spline(line, 3001, orientations=uneven)
    same_turns(vb.Trail(fine.position[::1000], fine.orientation[::1000]), uneven)
    rates = (
        Rotation.from_quat(fine.orientation[1:]) * Rotation.from_quat(fine.orientation[:-1]).inv()
    ).as_rotvec() @ AXIS
    assert np.abs(np.diff(rates)).max() < 0.01 * np.abs(rates).max()


def test_one_position_is_the_first() -> None:
    assert vb.Trail.spline(WAY, 1).position.tolist() == [[0, 0, 0]]
    single = vb.Trail.whisk(
        pivot=(0, 0, 0), axis=(0, 1, 0), position=(0, 0, 1), start_angle=0, stop_angle=9, count=1
    )
    assert single.position.tolist() == [[0, 0, 1]]


POSES = """\
x,y,z,qx,qy,qz,qw
0.04,0.005,0.0,0.0,0.0,0.0,1.0
0.03,0.005,0.0,0.0,0.1,0.0,0.995
0.02,0.005,0.001,0.0,1.2,0.0,1.6
"""


def poses_file(folder: Path, text: str) -> Path:
    file = folder / "poses.csv"
    file.write_text(text)
    return file


def test_poses_of_a_file(tmp_path: Path) -> None:
    trail = vb.Trail.from_csv(poses_file(tmp_path, POSES))
    np.testing.assert_array_equal(
        trail.position, [(0.04, 0.005, 0), (0.03, 0.005, 0), (0.02, 0.005, 0.001)]
    )
    np.testing.assert_allclose(trail.orientation[2], [0, 0.6, 0, 0.8], rtol=1e-15)


def test_columns_come_in_any_order_and_time_is_left_out(tmp_path: Path) -> None:
    lines = [line.split(",") for line in POSES.splitlines()]
    order = [6, 2, 0, 1, 3, 5, 4]
    times = ["time", "0.0", "0.5", "0.6"]
    text = "\r\n".join(
        ",".join([cells[i] for i in order] + [time])
        for cells, time in zip(lines, times, strict=True)
    )
    mixed = vb.Trail.from_csv(str(poses_file(tmp_path, text + "\r\n")))
    plain = vb.Trail.from_csv(poses_file(tmp_path, POSES))
    np.testing.assert_array_equal(mixed.position, plain.position)
    np.testing.assert_array_equal(mixed.orientation, plain.orientation)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    trail = vb.Trail.whisk(
        pivot=CENTER, axis=AXIS, position=START, start_angle=-1, stop_angle=1, count=20
    )
    file = tmp_path / "poses.csv"
    np.savetxt(
        file,
        np.hstack([trail.position, trail.orientation]),
        delimiter=",",
        header="x,y,z,qx,qy,qz,qw",
        comments="",
    )
    back = vb.Trail.from_csv(file)
    np.testing.assert_array_equal(back.position, trail.position)
    np.testing.assert_allclose(back.orientation, trail.orientation, rtol=0, atol=1e-16)


FILE_DAMAGE = {
    "not a number": (
        POSES.replace("0.1", "nan"),
        "line 3: qy = nan (1 of 3 rows are out of range); allowed are finite numbers",
    ),
    "words": (POSES.replace("0.03", "three"), "line 3: x = 'three'; allowed is a number"),
    "a missing column": (
        POSES.replace(",qw", "", 1),
        "line 1: columns: missing qw; allowed are x,y,z,qx,qy,qz,qw, and optionally time",
    ),
    "an unknown column": (
        POSES.replace("x,y", "x,y,w", 1),
        "line 1: columns: unknown w; allowed are",
    ),
    "a column twice": (
        POSES.replace("qx,qy", "qx,qx", 1),
        "line 1: columns: missing qy, twice qx; allowed are",
    ),
    "time twice": (
        POSES.replace("x,y", "time,time,x,y", 1),
        "line 1: columns: twice time; allowed are",
    ),
    "a short last line": (
        POSES[:-8],
        "line 4: 6 of 7 columns, the line is truncated or damaged; allowed are 7 numbers a line",
    ),
    "a short last number": (POSES[:-2], "line 4: qw = '1.', the last line is truncated"),
    "no rotation": (
        POSES.replace("0.0,1.2,0.0,1.6", "0,0,0,0"),
        "line 4: qx,qy,qz,qw = [0.0, 0.0, 0.0, 0.0] has zero norm (1 such); allowed is any quaternion",
    ),
    "time backwards": (
        "time,x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0,1\n0,0,0,0,0,0,0,1\n",
        "line 3: time = 0.0 after 1.0 (1 such); allowed are increasing times",
    ),
    "no rows": ("x,y,z,qx,qy,qz,qw\n", "no rows; allowed is at least one"),
    "nothing": ("", "empty; allowed is CSV with the columns x,y,z,qx,qy,qz,qw"),
    "far away": (
        POSES.replace("0.03", "1e300"),
        "line 3: x = 1e+300 (1 of 3 rows are out of range); allowed are finite numbers up to 1e+12",
    ),
}


@pytest.mark.parametrize("what", FILE_DAMAGE)
def test_damage_to_a_file_of_poses_is_named(tmp_path: Path, what: str) -> None:
    text, message = FILE_DAMAGE[what]
    file = poses_file(tmp_path, text)
    with pytest.raises(
        InputError, match=re.escape(f"{file}") + "[,:] " + re.escape(message)
    ) as caught:
        vb.Trail.from_csv(file)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path, "\0"):
        with pytest.raises(InputError, match="cannot be read"):
            vb.Trail.from_csv(path)


def matrix(**change: object) -> np.ndarray:
    result = np.tile(np.eye(4), (3, 1, 1))
    for place, value in change.items():
        result[1, int(place[1]), int(place[2])] = value
    return result


ARC = {"center": (0, 0, 0), "axis": (0, 0, 1), "start": (1, 0, 0), "angle": 1.0, "count": 3}
WHISK = {
    "pivot": (0, 0, 0),
    "axis": (0, 0, 1),
    "position": (1, 0, 0),
    "start_angle": 0.0,
    "stop_angle": 1.0,
    "count": 3,
}
BAD = {
    "an arc of no radius": (
        lambda: vb.Trail.arc(**ARC | {"start": (0, 0, 5)}),
        "start = [0.0, 0.0, 5.0] lies on the line through center along axis; allowed is a point off it",
    ),
    "no axis": (
        lambda: vb.Trail.arc(**ARC | {"axis": (0, 0, 0)}),
        "axis = [0.0, 0.0, 0.0]; allowed is any 3-vector",
    ),
    "no angle": (
        lambda: vb.Trail.arc(**ARC | {"angle": np.nan}),
        "angle = nan; allowed is a finite number",
    ),
    "no count": (
        lambda: vb.Trail.arc(**ARC | {"count": 0}),
        "count = 0; allowed is a whole number of at least 1",
    ),
    "two turns of the arc": (
        lambda: vb.Trail.arc(**ARC, orientation=TURN, rod_axis=(0, 0, 1)),
        "rod_axis = (0, 0, 1) beside orientation; allowed is one of the two",
    ),
    "a turn of no norm": (
        lambda: vb.Trail.arc(**ARC, orientation=(0, 0, 0, 0)),
        "orientation = [0.0, 0.0, 0.0, 0.0] has zero norm",
    ),
    "turns for one": (
        lambda: vb.Trail.whisk(**WHISK, orientation=np.eye(4)),
        "orientation has shape (4, 4); allowed is one quaternion (4,)",
    ),
    "a start of no number": (
        lambda: vb.Trail.whisk(**WHISK | {"start_angle": -np.inf}),
        "start_angle = -inf; allowed is a finite number",
    ),
    "half turns": (
        lambda: vb.Trail.whisk(**WHISK | {"stop_angle": 2 * np.pi}),
        "count = 3: steps of half a turn or more from 0 to 6.28319 rad; allowed is at least 4",
    ),
    "a pivot in the plane": (
        lambda: vb.Trail.whisk(**WHISK | {"pivot": (0, 0)}),
        "pivot has shape (2,); allowed is (3,)",
    ),
    "one way-point": (
        lambda: vb.Trail.spline([(0, 0, 0)], 5),
        "points has shape (1, 3); allowed are at least two way-points (k, 3)",
    ),
    "a way-point twice": (
        lambda: vb.Trail.spline([(0, 0, 0), (1, 0, 0), (1, 0, 0)], 5),
        "points[2] equals the way-point before it; allowed are successive points that differ",
    ),
    "turns of other way-points": (
        lambda: vb.Trail.spline(WAY, 5, orientations=np.ones((3, 4))),
        "orientations has shape (3, 4); allowed is (4,) or (4, 4), as points has",
    ),
    "two turns of the spline": (
        lambda: vb.Trail.spline(WAY, 5, orientations=TURN, rod_axis=(0, 0, 1)),
        "rod_axis = (0, 0, 1) beside orientations; allowed is one of the two",
    ),
    "one matrix": (
        lambda: vb.Trail.from_poses(np.eye(4)),
        "poses has shape (4, 4); allowed is (n, 4, 4) for one trail or",
    ),
    "small matrices": (
        lambda: vb.Trail.from_poses(np.ones((3, 3, 3))),
        "poses has shape (3, 3, 3); allowed is (…, 4)",
    ),
    "transposed": (
        lambda: vb.Trail.from_poses(matrix(r30=0.2)),
        "[0.2, 0.0, 0.0, 1.0]]; allowed are a rotation and a translation above the row",
    ),
    "scaled": (
        lambda: vb.Trail.from_poses(matrix(r00=1.01)),
        "poses[1] = [[1.01, 0.0, 0.0, 0.0], ",
    ),
    "mirrored": (
        lambda: vb.Trail.from_poses(matrix(r00=-1)),
        "poses[1] = [[-1.0, 0.0, 0.0, 0.0], ",
    ),
    "a matrix of no number": (
        lambda: vb.Trail.from_poses(matrix(r03=np.nan)),
        "poses[1, 0, 3] = nan; allowed are finite",
    ),
    "rotations alone": (
        lambda: vb.Trail.from_poses(TURN),
        "position = None; allowed are clamp points (n, 3) beside a Rotation",
    ),
    "points twice": (
        lambda: vb.Trail.from_poses(matrix(), position=np.zeros((3, 3))),
        "position: the matrices hold it; allowed is",
    ),
}


@pytest.mark.usefixtures("no_shape_checks")
@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_named(what: str) -> None:
    build, message = BAD[what]
    with pytest.raises(ValueError, match=re.escape(message)):
        build()
