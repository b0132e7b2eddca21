"""One recording in every format: the reactions are those of its CSV."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr
from bench_files import HEADER, RECORDING, SETUP, recording_table
from mcap_files import (
    FRAMES,
    POSE,
    STORE,
    WRENCH,
    frame_message,
    mcap_bytes,
    pose_message,
    wrench_message,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.io import InputError
from vibrissa.io.recordings.table import RecordingTable

NAMES = HEADER.split(",")
TABLE = np.genfromtxt(RECORDING.splitlines()[1:], delimiter=",")
COLUMNS = dict(zip(NAMES, TABLE.T, strict=True))
ARRAYS = {
    "time": TABLE[:, 0],
    "position": TABLE[:, 1:4],
    "orientation": TABLE[:, 4:8],
    "force": TABLE[:, 8:11],
    "torque": TABLE[:, 11:],
}
IN_STRUCT = {name: f"log.{name}" for name in ARRAYS}


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> vb.Setup:
    file = tmp_path_factory.mktemp("setup") / "setup.toml"
    file.write_text(SETUP)
    return vb.load_setup(file)


@pytest.fixture(scope="module")
def expected(setup: vb.Setup, tmp_path_factory: pytest.TempPathFactory) -> vb.Reactions:
    file = tmp_path_factory.mktemp("csv") / "trail.csv"
    file.write_text(RECORDING)
    return vb.read_recording(file, setup)


def same(found: vb.Reactions, expected: vb.Reactions) -> None:
    np.testing.assert_allclose(found.time, expected.time, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.force, expected.force, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.moment, expected.moment, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.trail.position, expected.trail.position, rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        found.trail.orientation, expected.trail.orientation, rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-12)


def parquet(file: Path, *, lists: bool = False) -> None:
    columns = (
        {name: list(map(list, part)) if part.ndim == 2 else part for name, part in ARRAYS.items()}
        if lists
        else COLUMNS
    )
    pq.write_table(pa.table(columns), file, compression="zstd")


def parquet_of_stamps(file: Path) -> None:
    stamps = pa.array(np.round(1e9 * TABLE[:, 0]).astype(np.int64), pa.timestamp("ns"))
    pq.write_table(pa.table({**COLUMNS, "time": stamps, "fx": pa.array(TABLE[:, 8])}), file)


def hdf5(file: Path, *, kind: str = "arrays") -> None:
    with h5py.File(file, "w") as opened:
        if kind == "table":
            opened["log/rows"] = np.array(
                list(map(tuple, TABLE)), dtype=[(name, "f8") for name in NAMES]
            )
            return
        if kind == "matrix":
            opened.create_dataset("all", data=TABLE, chunks=True, compression="gzip")
            return
        for name, part in ARRAYS.items():
            opened.create_dataset(name, data=part, compression="gzip")


def netcdf(file: Path, *, engine: str) -> None:
    arrays = {
        name: (("sample", f"axis{part.shape[1]}") if part.ndim == 2 else ("sample",), part)
        for name, part in ARRAYS.items()
    }
    data = xr.Dataset(arrays)
    data["force"] = data.force * 1e3
    data.force.attrs["units"] = "mN"
    data.torque.attrs["units"] = "N m"
    data.to_netcdf(
        file, engine=engine, **({"format": "NETCDF3_64BIT"} if engine == "scipy" else {})
    )


def packed_netcdf(file: Path) -> None:
    """Forces as 32-bit integers with a scale and an offset, as the CF conventions pack them."""
    with h5py.File(file, "w") as opened:
        for name, part in ARRAYS.items():
            opened[name] = np.round((part - 1) / 1e-8).astype(np.int64) if name == "force" else part
        opened["force"].attrs.update({"scale_factor": 1e-8, "add_offset": 1.0})


def matlab(file: Path, *, version: str = "5", struct: bool = False) -> None:
    savemat(
        file, {"log": ARRAYS} if struct else ARRAYS, format=version, do_compression=version == "5"
    )


def matlab_73(file: Path) -> None:
    """As MATLAB writes it: HDF5 behind 512 bytes of its own, arrays column by column."""
    with h5py.File(file, "w", userblock_size=512) as opened:
        for name, part in ARRAYS.items():
            opened[f"log/{name}"] = np.atleast_2d(part.T)
    with file.open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def bag(
    folder: Path,
    plugin: StoragePlugin,
    mode: CompressionMode = CompressionMode.NONE,
    *,
    frames: bool = False,
) -> None:
    """By the library's own writer."""
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        wrench = writer.add_connection("/ft/raw", WRENCH, typestore=STORE)
        pose = writer.add_connection(
            "/tf" if frames else "/tool", FRAMES if frames else POSE, typestore=STORE
        )
        if frames:
            static = writer.add_connection("/tf_static", FRAMES, typestore=STORE)
            writer.write(static, 0, frame_message(0, "arm", "sensor", MOUNT, MOUNT_TURN.as_quat()))
        for row in TABLE:
            stamp = round(row[0] * 1e9)
            writer.write(wrench, stamp, wrench_message(row))
            writer.write(pose, stamp, arm_message(row) if frames else pose_message(row))


MOUNT, MOUNT_TURN = np.array([0.01, -0.02, 0.1]), Rotation.from_quat([0.5, 0.5, -0.5, 0.5])


def arm_message(row: np.ndarray) -> bytes:
    """Pose of the arm that carries the sensor, whose own pose is the row's."""
    turn = Rotation.from_quat(row[4:8]) * MOUNT_TURN.inv()
    return frame_message(row[0], "world", "arm", row[1:4] - turn.apply(MOUNT), turn.as_quat())


WAYS: dict[str, tuple[str, Callable[[Path], object], dict]] = {
    "Parquet": ("a.parquet", parquet, {}),
    "Parquet of lists": ("a.parquet", lambda file: parquet(file, lists=True), {}),
    "Parquet of stamps": ("a.parquet", parquet_of_stamps, {}),
    "Parquet by another suffix": ("a.log", parquet, {}),
    "HDF5": ("a.h5", hdf5, {}),
    "HDF5, one matrix": (
        "a.h5",
        lambda file: hdf5(file, kind="matrix"),
        {
            "time": "all[0]",
            "position": [f"all[{k}]" for k in (1, 2, 3)],
            "orientation": [f"all[{k}]" for k in (4, 5, 6, 7)],
            "force": [f"all[{k}]" for k in (8, 9, 10)],
            "torque": [f"all[{k}]" for k in (11, 12, 13)],
        },
    ),
    "HDF5, a table in a group": (
        "a.h5",
        lambda file: hdf5(file, kind="table"),
        {
            "time": "log/rows/time",
            "position": [f"log/rows/{name}" for name in NAMES[1:4]],
            "orientation": [f"log/rows/{name}" for name in NAMES[4:8]],
            "force": [f"log/rows/{name}" for name in NAMES[8:11]],
            "torque": [f"log/rows/{name}" for name in NAMES[11:]],
        },
    ),
    "NetCDF 4": ("a.nc", lambda file: netcdf(file, engine="h5netcdf"), {}),
    "NetCDF 3": ("a.nc", lambda file: netcdf(file, engine="scipy"), {}),
    "NetCDF, packed": ("a.nc", packed_netcdf, {}),
    "MATLAB 4": ("a.mat", lambda file: matlab(file, version="4"), {}),
    "MATLAB 7": ("a.mat", matlab, {}),
    "MATLAB 7, a struct": ("a.mat", lambda file: matlab(file, struct=True), IN_STRUCT),
    "MATLAB 7.3, a struct": ("a.mat", matlab_73, IN_STRUCT),
    "MCAP": ("a.mcap", lambda file: file.write_bytes(mcap_bytes()), {}),
    "MCAP in chunks": (
        "a.mcap",
        lambda file: file.write_bytes(mcap_bytes(packing="plain", chunks=3)),
        {},
    ),
    "MCAP, zstd": (
        "a.mcap",
        lambda file: file.write_bytes(mcap_bytes(packing="zstd", chunks=2)),
        {},
    ),
    "MCAP, lz4": ("a.mcap", lambda file: file.write_bytes(mcap_bytes(packing="lz4", chunks=2)), {}),
    "MCAP of frames": ("a.mcap", lambda file: file.write_bytes(mcap_bytes(frames=True)), {}),
    "MCAP by its log times": (
        "a.mcap",
        lambda file: file.write_bytes(mcap_bytes()),
        {"stamps": "log"},
    ),
    "rosbag2 of MCAP": ("bag", lambda folder: bag(folder, StoragePlugin.MCAP), {}),
    "rosbag2 of MCAP, packed": (
        "bag",
        lambda folder: bag(folder, StoragePlugin.MCAP, CompressionMode.STORAGE),
        {},
    ),
    "rosbag2 of SQLite": (
        "bag",
        lambda folder: bag(folder, StoragePlugin.SQLITE3),
        {"wrench_topic": "/ft/raw", "pose_topic": "/tool"},
    ),
    "rosbag2 of SQLite, packed messages": (
        "bag",
        lambda folder: bag(folder, StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        {},
    ),
    "rosbag2 of SQLite, packed file": (
        "bag",
        lambda folder: bag(folder, StoragePlugin.SQLITE3, CompressionMode.FILE),
        {},
    ),
    "rosbag2 of frames": (
        "bag",
        lambda folder: bag(folder, StoragePlugin.SQLITE3, frames=True),
        {"fixed_frame": "world", "sensor_frame": "sensor"},
    ),
}


@pytest.mark.parametrize("way", WAYS)
def test_every_format_gives_the_same_reactions(
    tmp_path: Path, setup: vb.Setup, expected: vb.Reactions, way: str
) -> None:
    name, write, keys = WAYS[way]
    write(tmp_path / name)
    layout = RecordingTable.model_validate(keys) if keys else None
    same(vb.read_recording(tmp_path / name, replace(setup, recording=layout)), expected)


def test_one_file_of_a_bag_is_read_without_its_folder(
    tmp_path: Path, setup: vb.Setup, expected: vb.Reactions
) -> None:
    bag(tmp_path / "bag", StoragePlugin.SQLITE3)
    same(vb.read_recording(next((tmp_path / "bag").glob("*.db3")), setup), expected)


@pytest.mark.parametrize("damage", ["missing", "no YAML", "other YAML"])
def test_a_bag_without_metadata_is_read_and_said_to_be(
    tmp_path: Path, setup: vb.Setup, expected: vb.Reactions, damage: str
) -> None:
    bag(tmp_path / "bag", StoragePlugin.MCAP)
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.unlink() if damage == "missing" else metadata.write_text(
        "a: [" if damage == "no YAML" else "- 1\n"
    )
    with pytest.warns(vb.io.RecordingWarning, match="metadata.yaml is"):
        same(vb.read_recording(tmp_path / "bag", setup), expected)


REFUSED = {
    "array that is not there": (
        "a.h5",
        hdf5,
        {"force": "f"},
        ["force = 'f' is not in the file", "it holds", "torque"],
    ),
    "column beyond": (
        "a.h5",
        hdf5,
        {"time": "force[3]"},
        ["time = 'force[3]'", "shape (40, 3)", "count from 0"],
    ),
    "too few columns": (
        "a.h5",
        hdf5,
        {"force": ["force[0]", "force[1]"]},
        ["force", "2 columns", "allowed are 3"],
    ),
    "a matrix for a time": ("a.h5", hdf5, {"time": "force"}, ["time = 'force' has shape (40, 3)"]),
    "another unit than the file's": (
        "a.nc",
        lambda file: netcdf(file, engine="h5netcdf"),
        {"force_unit": "N"},
        ["force_unit = 'N', but the file says 'mN'"],
    ),
    "topic that is not there": (
        "bag",
        lambda folder: bag(folder, StoragePlugin.MCAP),
        {"wrench_topic": "/ft"},
        ["wrench_topic = '/ft'", "/ft/raw"],
    ),
    "topic of another type": (
        "bag",
        lambda folder: bag(folder, StoragePlugin.MCAP),
        {"wrench_topic": "/tool"},
        ["is no topic of geometry_msgs/WrenchStamped"],
    ),
    "frame that is not there": (
        "bag",
        lambda folder: bag(folder, StoragePlugin.MCAP, frames=True),
        {"fixed_frame": "map"},
        ["no chain of frames from fixed_frame = 'map'", "arm, sensor, world"],
    ),
    "only static frames": (
        "bag",
        lambda folder: bag(folder, StoragePlugin.MCAP, frames=True),
        {"fixed_frame": "arm"},
        ["no frame between 'arm' and 'sensor' is on /tf", "allowed is a moving sensor"],
    ),
    "text in a column": (
        "a.parquet",
        lambda file: pq.write_table(pa.table({**COLUMNS, "fx": ["a"] * len(TABLE)}), file),
        {},
        ["'fx' of shape (40,) holds ['a']", "allowed are real numbers"],
    ),
    "text in a matrix": (
        "a.mat",
        lambda file: savemat(file, {**ARRAYS, "force": "none"}),
        {},
        ["'force'", "allowed are real numbers"],
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_does_not_fit_is_named(tmp_path: Path, setup: vb.Setup, what: str) -> None:
    name, write, keys, words = REFUSED[what]
    write(tmp_path / name)
    with pytest.raises(InputError) as caught:
        vb.read_recording(
            tmp_path / name, replace(setup, recording=RecordingTable.model_validate(keys))
        )
    message = str(caught.value)
    assert message.startswith(str(tmp_path / name))
    assert [word for word in words if word not in message] == []


OTHERS = {
    "a.bag": (b"#ROSBAG V2.0\n", "is a bag of ROS 1"),
    "a.xlsx": (b"PK\x03\x04abc", "is a ZIP archive"),
    "a.csv.gz": (b"\x1f\x8b\x08abc", "is gzip"),
    "a.feather": (b"ARROW1\0\0", "is Arrow IPC"),
    "a.parquet": (RECORDING.encode(), "begins with b'time,px,', which is no Parquet"),
    "a.mcap": (b"", "begins with b'', which is no rosbag2 or MCAP"),
    "a.mat": (b"\0" * 40, "damaged .mat"),
    "a.h5": (b"\x89HDF\r\n\x1a\n" + b"\0" * 90, "damaged HDF5"),
    "b.parquet": (b"PAR1" + b"\0" * 90, "damaged Parquet"),
    "a.nc": (b"CDF\x01" + b"\xff" * 90, "damaged NetCDF"),
    "a.db3": (b"SQLite format 3\0" + b"\0" * 90, "damaged SQLite"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_contents_are_told_by_what_they_begin_with(
    tmp_path: Path, setup: vb.Setup, name: str
) -> None:
    content, words = OTHERS[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        vb.read_recording(tmp_path / name, setup)
    assert words in str(caught.value)
    assert "allowed" in str(caught.value)


def test_a_missing_library_is_named_with_its_command(
    tmp_path: Path, setup: vb.Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    parquet(tmp_path / "a.parquet")
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"pip install 'vibrissa\[recordings\]'"):
        vb.read_recording(tmp_path / "a.parquet", setup)


def test_the_table_of_the_recording_is_that_of_the_csv() -> None:
    np.testing.assert_allclose(TABLE, recording_table(), atol=1e-4)


def test_a_null_marks_its_row(tmp_path: Path, setup: vb.Setup, expected: vb.Reactions) -> None:
    file = tmp_path / "a.parquet"
    pq.write_table(
        pa.table({**COLUMNS, "fx": pa.array([*TABLE[:19, 8], None, *TABLE[20:, 8]])}), file
    )
    found = vb.read_recording(file, setup)
    assert np.flatnonzero(np.isnan(found.force).any(axis=1)).tolist() == [19]
    np.testing.assert_allclose(
        np.delete(found.force, 19, axis=0),
        np.delete(expected.force, 19, axis=0),
        rtol=0,
        atol=1e-12,
    )


def test_parts_of_structs_are_named_with_points(
    tmp_path: Path, setup: vb.Setup, expected: vb.Reactions
) -> None:
    """As a ROS message is unfolded: structs of structs, several row groups, lists beside them."""
    wrench = [
        {
            "force": dict(zip("xyz", row[8:11], strict=True)),
            "torque": dict(zip("xyz", row[11:], strict=True)),
        }
        for row in TABLE.tolist()
    ]
    columns = {
        "time": TABLE[:, 0],
        "wrench": wrench,
        "position": TABLE[:, 1:4].tolist(),
        "orientation": TABLE[:, 4:8].tolist(),
    }
    file = tmp_path / "a.parquet"
    pq.write_table(pa.table(columns), file, row_group_size=16, compression="zstd")
    names = {part: [f"wrench.{part}.{axis}" for axis in "xyz"] for part in ("force", "torque")}
    same(vb.read_recording(file, replace(setup, recording=RecordingTable(**names))), expected)


CUT = {
    "a.parquet": (parquet, "damaged Parquet"),
    "a.h5": (hdf5, "damaged HDF5"),
    "a.nc": (lambda file: netcdf(file, engine="scipy"), "damaged NetCDF"),
    "a.mat": (matlab, "damaged .mat"),
}


@pytest.mark.parametrize("name", CUT)
@pytest.mark.parametrize("share", [0.3, 0.8])
def test_a_file_that_is_cut_off_is_one_line_that_names_it(
    tmp_path: Path, setup: vb.Setup, name: str, share: float
) -> None:
    write, words = CUT[name]
    write(tmp_path / name)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError) as caught:
        vb.read_recording(tmp_path / name, setup)
    assert str(caught.value).startswith(f"{tmp_path / name}: {words}")
    assert "allowed is a whole file" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_capitals_in_names_do_not_matter(
    tmp_path: Path, setup: vb.Setup, expected: vb.Reactions
) -> None:
    pq.write_table(
        pa.table({name.upper(): part for name, part in COLUMNS.items()}), tmp_path / "a.parquet"
    )
    savemat(tmp_path / "a.mat", {name.title(): part for name, part in ARRAYS.items()})
    for name in ("a.parquet", "a.mat"):
        same(vb.read_recording(tmp_path / name, setup), expected)
