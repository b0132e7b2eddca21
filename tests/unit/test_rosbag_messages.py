"""Messages as bytes: those put together here many at a time, against `rosbags` one by one; and
clouds against the contacts they hold.
"""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

import vibrissa as vb
from vibrissa.io.rosbag import McapSink
from vibrissa.io.rosbag.messages import POSE, WRENCH, MessageWriter
from vibrissa.sensor import RawRecording

STAMP = 1_795_292_914_999_999_999 + np.arange(5, dtype=np.int64) * 142_857


def numbers(width: int) -> np.ndarray:
    return np.random.default_rng(width).normal(size=(5, width)) * 1e3


@pytest.fixture(scope="module")
def found() -> vb.Reconstruction:
    """Four contacts of the shipped recording, the second row without one."""
    folder = Path(__file__).parents[2] / "examples/recordings/sphere_60mm"
    setup = vb.load_setup(folder / "setup.toml")
    reactions = vb.read_recording(folder / "trail.csv", setup)
    rows = [400, 10, 450, 500, 550]
    trail = vb.Trail(reactions.trail.position[rows], reactions.trail.orientation[rows])
    covariance = np.diag([4e-6] * 3 + [1.6e-9] * 3)
    return vb.reconstruct(
        setup.rod,
        vb.Reactions(trail, reactions.force[rows], reactions.moment[rows], covariance=covariance),
    )


@pytest.mark.parametrize("frame", ["", "s", "sensor", "a_sensor_with_a_longer_name"])
def test_wrenches_and_poses_are_what_rosbags_writes(frame: str) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    types, writer = store.types, MessageWriter(wrench_frame=frame, world_frame=frame)
    values, poses = numbers(6), numbers(7)
    blocks = (
        writer.stamped(WRENCH, STAMP, STAMP, values, np.arange(5)),
        writer.stamped(POSE, STAMP, STAMP, poses),
    )
    for row in range(5):
        moment = types["builtin_interfaces/msg/Time"](
            sec=int(STAMP[row] // 10**9), nanosec=int(STAMP[row] % 10**9)
        )
        header = types["std_msgs/msg/Header"](stamp=moment, frame_id=frame)
        vector = types["geometry_msgs/msg/Vector3"]
        wrench = types["geometry_msgs/msg/Wrench"](
            force=vector(*values[row, :3]), torque=vector(*values[row, 3:])
        )
        place = types["geometry_msgs/msg/Point"](*poses[row, :3])
        pose = types["geometry_msgs/msg/Pose"](
            position=place, orientation=types["geometry_msgs/msg/Quaternion"](*poses[row, 3:])
        )
        for block, name, body in zip(blocks, ("Wrench", "Pose"), (wrench, pose), strict=True):
            kind = f"geometry_msgs/msg/{name}Stamped"
            expected = bytes(store.serialize_cdr(types[kind](header, body), kind))
            begin = int(block.offset[row]) + 31
            assert block.data[begin : begin + len(expected)] == expected


def test_a_file_holds_what_was_given(tmp_path: Path, found: vb.Reconstruction) -> None:
    """Read with both libraries: raw wrench, poses, and a cloud with position, normal, standard
    deviations, kind, and time of each contact.
    """
    file = tmp_path / "contacts.mcap"
    sink = McapSink(file)
    wrench, pose = numbers(6), numbers(7)
    pose[3] = np.nan
    sink.wrench(STAMP, np.arange(7, 12), wrench[:, :3], wrench[:, 3:])
    sink.contacts(
        STAMP,
        RawRecording(np.arange(5.0), pose[:, :3], pose[:, 3:], wrench[:, :3], wrench[:, 3:]),
        found,
    )
    sink.flush()
    cut = file.read_bytes()
    sink.close()
    (tmp_path / "cut.mcap").write_bytes(cut)
    for name in ("contacts.mcap", "cut.mcap"):
        check(tmp_path / name, found, wrench, pose)


def check(file: Path, found: vb.Reconstruction, wrench: np.ndarray, pose: np.ndarray) -> None:
    with file.open("rb") as stream:
        by_mcap = [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
        ]
    with AnyReader([file]) as reader:
        rows = [
            (connection, moment, bytes(data), reader.deserialize(data, connection.msgtype))
            for connection, moment, data in reader.messages()
        ]
        assert all(
            connection.ext.offered_qos_profiles[0].depth == 100 for connection in reader.connections
        )
    assert by_mcap == [(connection.topic, moment, data) for connection, moment, data, _ in rows]
    wrenches, poses, clouds = (
        [message for connection, _, _, message in rows if connection.topic == f"/vibrissa/{name}"]
        for name in ("wrench", "pose", "contacts")
    )
    assert [
        moment.header.stamp.sec * 10**9 + moment.header.stamp.nanosec for moment in wrenches
    ] == STAMP.tolist()
    got = [
        [
            getattr(getattr(message.wrench, part), axis)
            for part in ("force", "torque")
            for axis in "xyz"
        ]
        for message in wrenches
    ]
    np.testing.assert_array_equal(got, wrench)
    got = [
        [
            *(getattr(m.pose.position, axis) for axis in "xyz"),
            *(getattr(m.pose.orientation, axis) for axis in "xyzw"),
        ]
        for m in poses
    ]
    np.testing.assert_array_equal(got, pose[[0, 1, 2, 4]])
    (cloud,) = clouds
    check_cloud(cloud, found)


def check_cloud(cloud: object, found: vb.Reconstruction) -> None:
    kinds = {2: "u1", 7: "<f4", 8: "<f8"}
    layout = {
        "names": [f.name for f in cloud.fields],
        "formats": [kinds[f.datatype] for f in cloud.fields],
        "offsets": [f.offset for f in cloud.fields],
    }
    points = np.frombuffer(
        bytes(cloud.data), dtype=np.dtype({**layout, "itemsize": cloud.point_step})
    )
    rows = [0, 2, 3, 4]
    assert found.in_contact.tolist() == [True, False, True, True, True]
    assert (cloud.height, cloud.width, cloud.row_step, cloud.is_dense) == (
        1,
        4,
        4 * cloud.point_step,
        True,
    )
    assert cloud.header.frame_id == "world"
    for column, axis in enumerate("xyz"):
        np.testing.assert_allclose(points[axis], found.point[rows, column], rtol=1e-7)
        np.testing.assert_allclose(points[f"normal_{axis}"], found.normal[rows, column], rtol=1e-7)
        np.testing.assert_allclose(
            points[f"deviation_{axis}"], np.sqrt(found.covariance[rows, column, column]), rtol=1e-7
        )
    np.testing.assert_allclose(points["arc_length"], found.arc_length[rows], rtol=1e-7)
    assert points["kind"].tolist() == found.kind[rows].tolist()
    assert points["status"].tolist() == found.status[rows].tolist()
    stamp = cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
    np.testing.assert_allclose(stamp + np.round(points["time"] * 1e9), STAMP[rows], rtol=0, atol=0)


def test_log_times_never_fall(tmp_path: Path, found: vb.Reconstruction) -> None:
    """Contacts come later than their stamps say; a reader that wants order of time gets what is in
    the file.
    """
    file = tmp_path / "late.mcap"
    sink = McapSink(file)
    values, pose = numbers(6), np.tile([0.0, 0, 0, 0, 0, 0, 1], (5, 1))
    for part in range(3):
        sink.wrench(STAMP + part * 10**6, np.arange(5), values[:, :3], values[:, 3:])
        sink.flush()
    sink.contacts(
        STAMP,
        RawRecording(np.arange(5.0), pose[:, :3], pose[:, 3:], values[:, :3], values[:, 3:]),
        found,
    )
    sink.flush()
    with AnyReader([file]) as reader:
        moments = [moment for _, moment, _ in reader.messages()]
    assert moments == sorted(moments)
    assert len(moments) == 15 + 5 + 1
    sink.close()
