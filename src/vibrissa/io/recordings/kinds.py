"""Which format a file has: by what it begins with, then by its suffix."""

from enum import Enum
from pathlib import Path

from vibrissa.files import InputError, readable
from vibrissa.io.recordings.bags import is_bag


class Kind(Enum):
    """Formats of recordings."""

    TEXT = "CSV"
    PARQUET = "Parquet"
    HDF5 = "HDF5 or NetCDF 4"
    CLASSIC = "NetCDF 3"
    MATLAB = "MATLAB .mat"
    MATLAB_HDF5 = "MATLAB 7.3 .mat"
    BAG = "rosbag2 or MCAP"


_HDF5 = b"\x89HDF\r\n\x1a\n"
# What files begin with; those with a text are known, and not read.
_SIGNS: dict[bytes, Kind | str] = {
    b"PAR1": Kind.PARQUET,
    _HDF5: Kind.HDF5,
    b"CDF\x01": Kind.CLASSIC,
    b"CDF\x02": Kind.CLASSIC,
    b"MATLAB 5.0": Kind.MATLAB,
    b"MATLAB 7.3": Kind.MATLAB_HDF5,
    b"\x89MCAP0\r\n": Kind.BAG,
    b"SQLite format 3\0": Kind.BAG,
    b"\x28\xb5\x2f\xfd": Kind.BAG,
    b"#ROSBAG V": "a bag of ROS 1",
    b"ARROW1": "Arrow IPC (Feather)",
    b"PARE": "encrypted Parquet",
    b"CDF\x05": "NetCDF of 64-bit data (CDF-5)",
    b"PK\x03\x04": "a ZIP archive, as XLSX and NPZ are",
    b"\x1f\x8b": "gzip",
    b"\x93NUMPY": "a NumPy array",
    b"\x89PNG": "a PNG image",
}
_SUFFIXES = {
    Kind.PARQUET: (".parquet", ".pq"),
    Kind.HDF5: (".h5", ".hdf5", ".hdf", ".nc"),
    Kind.BAG: (".mcap", ".db3"),
    Kind.MATLAB: (".mat",),
}
# Places at which HDF5 may begin behind a block of the user's own (HDF5 specification, II.A).
_BLOCKS = (512, 1024, 2048, 4096)
_FORMATS = "CSV, Parquet, HDF5, NetCDF, MATLAB .mat, rosbag2 and MCAP"


def kind_of(path: Path) -> Kind:
    """Format of a recording.

    Raises
    ------
    InputError
        If the file cannot be read, is of a known format that is no recording, or is not what its
        suffix says.
    """
    if path.is_dir() and is_bag(path):
        return Kind.BAG
    with readable(path).open("rb") as opened:
        start = opened.read(_BLOCKS[-1] + len(_HDF5))
    found = next((kind for sign, kind in _SIGNS.items() if start.startswith(sign)), None)
    if isinstance(found, str):
        raise InputError(f"{path}: is {found}; allowed are {_FORMATS}")
    if found is None and any(start.startswith(_HDF5, block) for block in _BLOCKS):
        found = Kind.HDF5
    suffix = path.suffix.lower()
    said = next((kind for kind, known in _SUFFIXES.items() if suffix in known), Kind.TEXT)
    # MATLAB 4 has no sign of its own.
    if found is None and said not in {Kind.TEXT, Kind.MATLAB}:
        raise InputError(
            f"{path}: begins with {start[:8]!r}, which is no {said.value}; allowed are {_FORMATS}"
        )
    return found or said
