"""What a Parquet footer claims is read as pyarrow reads it, and never ends the process."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from bench_files import HEADER, RECORDING, SETUP

import vibrissa as vb
from vibrissa.io import InputError
from vibrissa.io.recordings.parquet_footer import chunks

NAMES = HEADER.split(",")
TABLE = np.genfromtxt(RECORDING.splitlines()[1:], delimiter=",")


@pytest.fixture
def setup(tmp_path: Path) -> vb.Setup:
    (tmp_path / "setup.toml").write_text(SETUP)
    return vb.load_setup(tmp_path / "setup.toml")


def plain(file: Path) -> Path:
    pq.write_table(pa.table(dict(zip(NAMES, TABLE.T, strict=True))), file)
    return file


def nested(file: Path) -> Path:
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
    pq.write_table(pa.table(columns), file, row_group_size=16, compression="zstd")
    return file


@pytest.mark.parametrize("write", [plain, nested])
def test_claims_are_those_that_the_library_reads(tmp_path: Path, write: object) -> None:
    file = write(tmp_path / "a.parquet")
    metadata = pq.ParquetFile(file).metadata
    parts = [
        metadata.row_group(group).column(index)
        for group in range(metadata.num_row_groups)
        for index in range(metadata.num_columns)
    ]
    assert [(".".join(chunk.path), chunk.values, chunk.size) for chunk in chunks(file)] == [
        (part.path_in_schema, part.num_values, part.total_uncompressed_size) for part in parts
    ]


def test_parts_of_structs_are_named_with_points(tmp_path: Path, setup: vb.Setup) -> None:
    (tmp_path / "a.csv").write_text(RECORDING)
    expected = vb.read_recording(tmp_path / "a.csv", setup)
    layout = '[recording]\nforce = ["wrench.force.x", "wrench.force.y", "wrench.force.z"]\ntorque = ["wrench.torque.x", "wrench.torque.y", "wrench.torque.z"]\n'
    (tmp_path / "setup.toml").write_text(SETUP + layout)
    found = vb.read_recording(
        nested(tmp_path / "a.parquet"), vb.load_setup(tmp_path / "setup.toml")
    )
    np.testing.assert_array_equal(found.force, expected.force)
    np.testing.assert_array_equal(found.moment, expected.moment)


def test_a_damaged_footer_never_ends_the_process(tmp_path: Path, setup: vb.Setup) -> None:
    """The library (26.0.1) aborts where a column's histogram has another length than its schema
    says.
    """
    good = plain(tmp_path / "good.parquet").read_bytes()
    size = int.from_bytes(good[-8:-4], "little")
    rng = np.random.default_rng(1)
    for case in range(120):
        content = bytearray(good)
        for place in len(good) - 8 - rng.integers(0, size, 1 + case % 4):
            content[place] ^= 1 << int(rng.integers(8))
        (tmp_path / f"{case}.parquet").write_bytes(bytes(content))
    script = (
        "import sys; from pathlib import Path; import numpy as np; import vibrissa as vb\n"
        "setup, ends = vb.load_setup(sys.argv[1]), [0, 0]\n"
        "for case in range(120):\n"
        "    try:\n"
        "        vb.read_recording(Path(sys.argv[2]) / f'{case}.parquet', setup); ends[0] += 1\n"
        "    except vb.io.InputError as error:\n"
        "        assert 'allowed' in str(error) or 'it holds' in str(error), error; ends[1] += 1\n"
        "print(*ends)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "setup.toml"), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-1000:]
    taken, refused = map(int, run.stdout.split())
    assert taken + refused == 120
    assert refused > 20


@pytest.mark.parametrize(
    "content",
    [
        b"PAR1PAR1",
        b"PAR1" + b"\xff" * 4 + b"PAR1",
        b"PAR1" + b"\x19\xfc\xff\xff\xff\x07" + b"\x06\0\0\0PAR1",
    ],
)
def test_a_footer_that_is_none(tmp_path: Path, setup: vb.Setup, content: bytes) -> None:
    (tmp_path / "a.parquet").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.parquet: damaged Parquet"):
        vb.read_recording(tmp_path / "a.parquet", setup)
