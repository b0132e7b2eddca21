"""Poses at the times of samples."""

import json
import socket
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vibrissa.live.poses import (
    ConstantPose,
    PoseMessage,
    StreamedPoses,
    TimedPoses,
    pose_bytes,
)
from vibrissa.trail import Trail, between

MS = 1_000_000
SECOND = 1_000_000_000


def turning(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A motion along a line while turning about z, both even."""
    return np.outer(time, [0.1, -0.2, 0.3]), Rotation.from_rotvec(
        np.outer(time, [0, 0, 0.7])
    ).as_quat()


def test_between_poses_the_motion_is_straight_and_even() -> None:
    time = np.array([0.0, 0.5, 0.6, 2.0, 2.5])
    wanted = np.linspace(0, 2.5, 301)
    found = between(time, Trail(*turning(time)), wanted)
    position, orientation = found.position, found.orientation
    true_position, true_orientation = turning(wanted)
    np.testing.assert_allclose(position, true_position, atol=1e-15)
    np.testing.assert_allclose(
        np.abs(np.sum(orientation * true_orientation, axis=1)), 1, atol=1e-14
    )
    outside = between(time, Trail(*turning(time)), np.array([-1.0, 3.0]))
    np.testing.assert_array_equal(outside.position, turning(time[[0, -1]])[0])


def test_a_planned_motion_begins_with_the_first_sample() -> None:
    time = np.linspace(0, 2, 21)
    poses = TimedPoses(time, *turning(time))
    start = 1_700_000_000 * SECOND
    first = poses.at(start + np.array([0, 100 * MS]))
    second = poses.at(start + np.array([1234 * MS, 9 * SECOND]))
    np.testing.assert_allclose(first.position, turning(np.array([0, 0.1]))[0], atol=1e-12)
    np.testing.assert_allclose(second.position, turning(np.array([1.234, 2.0]))[0], atol=1e-9)
    assert first.known.all()
    assert second.known.all()


@pytest.mark.parametrize(
    "wrong",
    [([0.0, 0.0], 2, 2), ([1.0, 0.5], 2, 2), ([0.0, 1.0], 2, 3), ([], 0, 0), ([0.0, np.nan], 2, 2)],
)
def test_motions_that_are_none(wrong: tuple[list[float], int, int]) -> None:
    time, positions, turns = wrong
    with pytest.raises(ValueError, match="allowed"):
        TimedPoses(time, np.zeros((positions, 3)), np.tile([0, 0, 0, 1.0], (turns, 1)))


def test_a_constant_pose() -> None:
    found = ConstantPose((1, 2, 3), (0, 0, 2, 0)).at(np.array([5, 6], dtype=np.int64))
    np.testing.assert_array_equal(found.position, [[1, 2, 3]] * 2)
    np.testing.assert_array_equal(found.orientation, [[0, 0, 1, 0]] * 2)


def test_messages_there_and_back() -> None:
    position, orientation = turning(np.array([0.4321]))
    sent = pose_bytes(1_700_000_000_123_456_789, position[0], orientation[0])
    found = PoseMessage.model_validate_json(sent)
    assert found.stamp == 1_700_000_000_123_456_789
    assert (found.position, found.orientation) == (tuple(position[0]), tuple(orientation[0]))
    unstamped = b'{"position": [1, 2, 3], "orientation": [0, 0, 0, 1]}'
    assert PoseMessage.model_validate_json(unstamped).stamp is None


GOOD = {"stamp": 1, "position": [0, 0, 0], "orientation": [0, 0, 0, 1]}
WRONG = {
    "no object": b"[1, 2, 3]",
    "cut off": json.dumps(GOOD).encode()[:-3],
    "no orientation": json.dumps({"stamp": 1, "position": [0, 0, 0]}).encode(),
    "another key": json.dumps(GOOD | {"speed": 1}).encode(),
    "two numbers": json.dumps(GOOD | {"position": [0, 0]}).encode(),
    "text": json.dumps(GOOD | {"position": ["0", 0, 0]}).encode(),
    "true": json.dumps(GOOD | {"position": [True, 0, 0]}).encode(),
    "not a number": b'{"position": [NaN, 0, 0], "orientation": [0, 0, 0, 1]}',
    "huge": json.dumps(GOOD | {"position": [10**400, 0, 0]}).encode(),
    "no unit quaternion": json.dumps(GOOD | {"orientation": [0, 0, 0, 2]}).encode(),
    "stamp with a fraction": json.dumps(GOOD | {"stamp": 1.5}).encode(),
    "stamp beyond 64 bits": json.dumps(GOOD | {"stamp": 2**70}).encode(),
    "deep": b"[" * 60_000,
    "no text": b"\xff\xfe\x00",
}


@pytest.mark.parametrize("name", WRONG)
def test_messages_that_are_none(name: str) -> None:
    with pytest.raises(ValueError):
        PoseMessage.model_validate_json(WRONG[name])


KEYS = st.sampled_from(["stamp", "position", "orientation"])
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.floats(),
    st.integers(),
    st.text(max_size=3),
    st.lists(st.floats(), max_size=5),
)


@given(
    st.binary(max_size=100)
    | st.dictionaries(KEYS, VALUES).map(lambda value: json.dumps(value).encode())
)
def test_anything_is_a_pose_or_a_value_error(data: bytes) -> None:
    try:
        found = PoseMessage.model_validate_json(data)
    except ValueError:
        return
    assert np.all(np.isfinite(found.position))


def streamed(every: int, count: int, *, gap: tuple[int, int] = (0, 0)) -> StreamedPoses:
    """Poses in milliseconds from 1 s on, without those in the gap."""
    poses = StreamedPoses(patience=0.05)
    for number in range(count):
        moment = SECOND + number * every * MS
        if not gap[0] <= number < gap[1]:
            position, orientation = turning(np.array([moment * 1e-9]))
            poses.take(pose_bytes(moment, position[0], orientation[0]), moment)
    return poses


def test_poses_that_were_swapped_doubled_or_stamped_by_another_clock() -> None:
    """Put in order; and one from a year ahead does not shut out those that follow."""
    poses, rng = StreamedPoses(patience=0.05), np.random.default_rng(0)
    order = np.arange(200)
    for start in range(0, 200, 8):
        rng.shuffle(order[start : start + 8])
    for place, number in enumerate(order.tolist()):
        moment = SECOND + number * 4 * MS
        position, orientation = turning(np.array([moment * 1e-9]))
        for _ in range(1 + (place % 5 == 0)):
            poses.take(pose_bytes(moment, position[0], orientation[0]), moment)
        if place % 50 == 3:
            poses.take(
                pose_bytes(moment + 365 * 86400 * SECOND, position[0], orientation[0]), moment
            )
    assert (poses.misplaced, poses.malformed) == (4, 0)
    stamp = SECOND + np.arange(0, 796 * MS, 777_777, dtype=np.int64)
    found = poses.at(stamp)
    assert found.known.all()
    np.testing.assert_allclose(found.position, turning(stamp * 1e-9)[0], atol=2e-5)


def test_streamed_poses_are_interpolated() -> None:
    poses = streamed(4, 100)
    stamp = SECOND + np.arange(0, 396 * MS, 777_777, dtype=np.int64)
    assert poses.ready(stamp, 0) == len(stamp)
    for part in np.array_split(stamp, 13):
        found = poses.at(part)
        assert found.known.all()
        np.testing.assert_allclose(found.position, turning(part * 1e-9)[0], atol=1e-12)


def test_a_sample_waits_for_its_pose() -> None:
    poses = streamed(10, 3)
    stamp = SECOND + np.array([5, 15, 25, 80], dtype=np.int64) * MS
    assert poses.ready(stamp, SECOND + 30 * MS) == 2
    assert poses.ready(stamp, SECOND + 76 * MS) == 3
    assert poses.ready(stamp, SECOND + 200 * MS) == 4
    assert poses.at(stamp).known.tolist() == [True, True, True, False]


def test_across_a_gap_no_pose_is_made_up() -> None:
    poses = streamed(10, 100, gap=(30, 60))
    stamp = SECOND + np.arange(0, 900, 7, dtype=np.int64) * MS
    known = poses.at(stamp).known
    within = (stamp > SECOND + (290 + 50) * MS) & (stamp < SECOND + (600 - 50) * MS)
    assert np.array_equal(known, ~within)


def test_no_pose_at_all() -> None:
    poses = StreamedPoses()
    stamp = np.array([SECOND], dtype=np.int64)
    assert poses.ready(stamp, SECOND) == 0
    assert poses.ready(stamp, 2 * SECOND) == 1
    assert not poses.at(stamp).known.any()


def test_over_udp_on_the_loopback_address() -> None:
    poses, stamp = StreamedPoses(port=0), np.array([7], dtype=np.int64)
    poses.open()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for data in (
                b"no pose",
                pose_bytes(7, np.array([1.0, 2.0, 3.0]), np.array([0, 0, 0, 1.0])),
            ):
                sender.sendto(data, ("127.0.0.1", poses.port))
        until = time.monotonic() + 5
        while not poses.ready(stamp, 0) and time.monotonic() < until:
            time.sleep(0.01)
    finally:
        poses.close()
    assert poses.malformed == 1
    np.testing.assert_array_equal(poses.at(stamp).position, [[1, 2, 3]])
