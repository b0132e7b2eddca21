"""A calibrated setup as a file: the setup it came from with the numbers found, and what is known of
them in a table [calibration].
"""

import os
from collections.abc import Iterator, MutableMapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from vibrissa.files import InputError, readable
from vibrissa.io.config import NO_TURN, ORIGIN, Finite, NotNegative, Table, number
from vibrissa.io.errors import writable
from vibrissa.libraries import extra_library
from vibrissa.tolerances import PARAMETERS

if TYPE_CHECKING:
    from vibrissa.calibration import Calibration
    from vibrissa.io.setup import Setup

FORMAT = 1
"""Version of the table [calibration]."""
_CHANNELS = 6
_STIFFNESS = ("youngs_modulus", "bending_stiffness")
_ENTRIES = dict.fromkeys(_STIFFNESS, ("bending_stiffness",)) | {
    f"{kind}_gain": tuple(f"gain_{kind}_{axis}" for axis in "xyz") for kind in ("force", "torque")
}
"""Parameters of `vibrissa.tolerances.PARAMETERS` that calibrations name otherwise."""

Text = Annotated[str, Field(description="text")]
Names = Annotated[list[str], Field(description="a list of names")]
Numbers = Annotated[list[NotNegative], Field(description="a list of numbers of at least 0")]
Matrix = Annotated[list[list[Finite]], Field(description="rows of finite numbers")]


class EstimateTable(Table):
    """One calibrated number, in its unit."""

    unit: Text
    given: Finite
    value: Finite
    standard_deviation: NotNegative | None = None
    holds_for: Names | None = None


class CalibrationTable(Table):
    """What is known of a calibrated setup's numbers; `tare` and `drift` have a row of six a
    recording.
    """

    format: Annotated[
        Literal[1], Field(description="1, the format that this version of vibrissa reads")
    ]
    vibrissa: Text
    date: Annotated[datetime, Field(description="a date and time")]
    recordings: Names
    setup: Text
    free: Names
    friction: NotNegative = 0.0
    unevenness: NotNegative = 0.0
    rows: Annotated[int, number("a whole number of at least 0", ge=0)]
    reduced_chi_square: NotNegative
    whiteness: NotNegative
    inflation: Numbers
    not_determined: Names
    names: Names
    correlation: Matrix
    tare: Matrix
    drift: Matrix
    disturbed: NotNegative | None = None
    held_out: Numbers | None = None
    warnings: Names | None = None
    estimates: Annotated[dict[str, EstimateTable], Field(description="a table for each estimate")]

    @model_validator(mode="after")
    def _fits(self) -> "CalibrationTable":
        """Names are those of estimates, and matrices have the sizes that belong to them."""
        for place, name in enumerate(self.names):
            if name not in self.estimates or name in self.names[:place]:
                raise ValueError(
                    f"names[{place}] = {name!r}; "
                    f"allowed is each once of {', '.join(self.estimates)}"
                )
        count, recordings = len(self.names), len(self.tare)
        for key, matrix, shape in (
            ("correlation", self.correlation, (count, count)),
            ("tare", self.tare, (recordings, _CHANNELS)),
            ("drift", self.drift, (recordings, _CHANNELS)),
            ("inflation", [self.inflation], (1, _CHANNELS)),
        ):
            if len(matrix) != shape[0]:
                raise ValueError(f"{key} has {len(matrix)} rows; allowed are {shape[0]}")
            for row in matrix:
                if len(row) != shape[1]:
                    raise ValueError(
                        f"{key} has a row of {len(row)} numbers; allowed are {shape[1]}"
                    )
        return self

    def covariance(self) -> Float[np.ndarray, "names names"]:
        """Covariance of the numbers `names`, in their units."""
        deviations = [self.estimates[name].standard_deviation or 0.0 for name in self.names]
        size = len(deviations)
        return np.reshape(self.correlation, (size, size)) * np.outer(deviations, deviations)

    def parameter_covariance(
        self, stated: Float[np.ndarray, "parameters parameters"]
    ) -> Float[np.ndarray, "parameters parameters"]:
        """Of the errors of `vibrissa.tolerances.PARAMETERS`: those that the calibration determined
        with its own covariance, the others as stated.
        """
        of_names = np.zeros((len(PARAMETERS), len(self.names)))
        for column, name in enumerate(self.names):
            relative = name in _STIFFNESS or "gain" in name
            rows = np.isin(PARAMETERS, _ENTRIES.get(name, (name,)))
            of_names[rows, column] = 1 / self.estimates[name].value if relative else 1.0
        own = np.any(of_names != 0, axis=1, keepdims=True)
        result = np.where(own | own.T, 0.0, stated)
        return np.asarray(result + of_names @ self.covariance() @ of_names.T)


def toml_library() -> Any:
    """Import `tomlkit`, which changes numbers in a TOML file and keeps the rest.

    Raises
    ------
    InputError
        If it is not installed; the text names the command that does it.
    """
    try:
        return extra_library(
            "tomlkit", extra="calibrate", need="writing a calibrated setup needs it"
        )
    except ImportError as error:
        raise InputError(str(error)) from error


def check_source(setup: "Setup", path: str | Path) -> None:
    """Raise InputError if the setup of this file cannot hold a calibrated rod: before the work is
    done.
    """
    if setup.rod.units != "SI":
        raise _no_stiffness(path)


def _no_stiffness(path: str | Path) -> InputError:
    return InputError(
        f"{path}: rod.kind = 'unit' cannot hold a calibrated rod; allowed are cylinder and uniform"
    )


def write_calibration(
    path: str | Path,
    calibration: "Calibration[Any]",
    setup: str | Path,
    recordings: Sequence[str | Path] = (),
    *,
    date: datetime | None = None,
) -> Path:
    """Write a setup that the other commands take: that of the file `setup` with the calibrated
    numbers and a table [calibration].

    Parameters
    ----------
    path
        TOML file to write; it may be the setup's own.
    calibration
        What was found with that setup.
    setup
        The setup's file. Its comments and all that was not calibrated are kept.
    recordings
        Names of the recordings, to be noted.
    date
        To be noted; now by default.

    Raises
    ------
    InputError
        If a file cannot be read or written, the setup's rod is one in the model's units, or tomlkit
        is not installed.
    """
    library = toml_library()
    source, file = Path(setup), writable(Path(path))
    document = library.parse(readable(source).read_text(encoding="utf-8"))
    if document["rod"]["kind"] == "unit":
        raise _no_stiffness(source)
    _set_numbers(document, calibration)
    _set_files(document, source.parent.resolve(), file.parent.resolve())
    date = date or datetime.now(UTC).replace(microsecond=0)
    document.pop("calibration", None)
    document.add("calibration", _table(library, calibration, source, recordings, date))
    file.write_text(library.dumps(document), encoding="utf-8")
    return file


def _set_numbers(document: Any, calibration: "Calibration[Any]") -> None:
    rod, sensor = calibration.setup.rod, calibration.setup.sensor
    if document["rod"]["kind"] == "cylinder":
        modulus = rod.bending_stiffness / (np.pi / 4 * rod.radius**4)
        _change(document["rod"], length=rod.length, youngs_modulus=modulus)
    else:
        _change(document["rod"], length=rod.length, bending_stiffness=rod.bending_stiffness)
    table = document["sensor"]
    for name in ("clamp_position", "clamp_orientation"):
        _change(table, **{name: getattr(sensor, name).tolist()})
    if "gain" in table or set(sensor.gain) != {1.0}:
        _change(table, gain=list(sensor.gain))
    if "object" in document and {"object_position", "object_orientation"} & set(calibration.free):
        table, (turn, move) = document["object"], calibration.pose
        rotation = Rotation.from_matrix(turn)
        before = Rotation.from_quat(list(table.get("rotation", NO_TURN)))
        place = np.array(list(table.get("translation", ORIGIN)), dtype=float)
        _change(
            table,
            rotation=(rotation * before).as_quat().tolist(),
            translation=(rotation.apply(place) + move).tolist(),
        )


def _change(table: MutableMapping[str, Any], **values: Any) -> None:
    """Set values, where they differ by more than rounding: what is as it was keeps its digits."""
    for name, value in values.items():
        old = table.get(name)
        if old is None or not np.allclose(np.array(old, dtype=float), value, rtol=1e-14, atol=0):
            table[name] = value


def _set_files(document: Any, old: Path, new: Path) -> None:
    """Meshes and motions are seen from the folder of the TOML file that names them."""
    if old == new:
        return
    named = [(table, "file") for table in _tables(document.get("object"))] + [
        (document.get("pose", {}), "path")
    ]
    for table, key in named:
        if key in table and not Path(str(table[key])).is_absolute():
            table[key] = Path(os.path.relpath(old / str(table[key]), new)).as_posix()


def _tables(value: Any) -> Iterator[MutableMapping[str, Any]]:
    if isinstance(value, MutableMapping):
        yield value
        for inner in list(value.values()):
            yield from _tables(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _tables(inner)


def _table(
    library: Any,
    calibration: "Calibration[Any]",
    source: Path,
    recordings: Sequence[str | Path],
    date: datetime,
) -> Any:
    """The table [calibration]; each row of a matrix has its own line."""
    from vibrissa import __version__  # noqa: PLC0415

    found, known = calibration.fitness, calibration.identifiability
    table = library.item(
        {
            "format": FORMAT,
            "vibrissa": __version__,
            "date": date,
            "recordings": [Path(recording).name for recording in recordings],
            "setup": source.name,
            "free": list(calibration.free),
            "friction": calibration.friction,
            "unevenness": _rounded(calibration.unevenness, 4),
            "rows": int(np.count_nonzero(calibration.residuals.contact)),
            "reduced_chi_square": found.reduced_chi_square,
            "whiteness": found.whiteness,
            "inflation": _rounded(found.inflation, 4),
            "disturbed": _rounded(found.disturbed, 4),
            "held_out": _rounded([part.reduced_chi_square for part in calibration.held_out], 4),
            "warnings": list(calibration.warnings),
            "not_determined": list(known.held),
            "names": list(known.names),
        }
    )
    for name, matrix in (
        ("correlation", np.round(known.correlation, 9).tolist()),
        ("tare", _rounded(calibration.tare, 5)),
        ("drift", _rounded(calibration.drift, 5)),
    ):
        lines = library.array()
        for row in matrix:
            lines.add_line(row)
        if matrix:
            lines.add_line(indent="")
        table.add(name, lines)
    estimates = {
        name: {"unit": one.unit, "given": one.given, "value": one.value}
        | ({"standard_deviation": one.deviation} if one.determined else {})
        for name, one in calibration.estimates.items()
    }
    table.add("estimates", library.item(estimates))
    return table


def _rounded(values: Any, digits: int) -> Any:
    """Numbers, however nested, to significant digits."""
    one = np.vectorize(lambda value: float(f"{value:.{digits}g}"), otypes=[float])
    return one(values).tolist()
