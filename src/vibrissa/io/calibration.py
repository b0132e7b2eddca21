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
from vibrissa.io.config import NO_TURN, ORIGIN, Finite, NotNegative, Table
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
    f"{kind}_gain": tuple(f"gain_{kind}_{axis}" for axis in ("x", "y", "z"))
    for kind in ("force", "torque")
}
"""Names of calibrations that are those of no parameter of `vibrissa.tolerances.PARAMETERS`, and
what they stand for there.
"""

Names = Annotated[list[str], Field(description="a list of names")]


class EstimateTable(Table):
    """One calibrated number, in its unit."""

    unit: Annotated[str, Field(description="a unit")]
    given: Finite
    value: Finite
    standard_deviation: NotNegative | None = None
    holds_for: Names | None = None


class CalibrationTable(Table):
    """What is known of a calibrated setup's numbers."""

    format: Annotated[
        Literal[1], Field(description="1, the format that this version of vibrissa reads")
    ]
    vibrissa: Annotated[str, Field(description="a version of vibrissa")]
    date: Annotated[datetime, Field(description="a date and time")]
    recordings: Names
    setup: Annotated[str, Field(description="the name of the setup that was started from")]
    free: Names
    friction: NotNegative = 0.0
    unevenness: NotNegative = 0.0
    rows: Annotated[int, Field(strict=True, ge=0, description="a whole number of at least 0")]
    reduced_chi_square: NotNegative
    whiteness: NotNegative
    inflation: Annotated[list[NotNegative], Field(description="a list of numbers of at least 0")]
    not_determined: Names
    names: Names
    correlation: Annotated[list[list[Finite]], Field(description="a matrix of finite numbers")]
    tare: Annotated[list[list[Finite]], Field(description="six finite numbers a recording")]
    drift: Annotated[list[list[Finite]], Field(description="six finite numbers a recording")]
    disturbed: NotNegative | None = None
    held_out: Annotated[
        list[NotNegative] | None, Field(description="a list of numbers of at least 0")
    ] = None
    warnings: Annotated[list[str] | None, Field(description="a list of sentences")] = None
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

    def covariance(self) -> np.ndarray:
        """Covariance (k, k) of the numbers `names`, in their units."""
        deviations = np.array(
            [self.estimates[name].standard_deviation or 0.0 for name in self.names]
        )
        return np.array(self.correlation).reshape(len(deviations), -1) * np.outer(
            deviations, deviations
        )

    def parameter_covariance(
        self, stated: Float[np.ndarray, "15 15"]
    ) -> Float[np.ndarray, "15 15"]:
        """Of the errors of `vibrissa.tolerances.PARAMETERS`: those that the calibration determined
        with its own covariance, the others as stated.
        """
        of_names = np.zeros((len(PARAMETERS), len(self.names)))
        for column, name in enumerate(self.names):
            rows = [
                PARAMETERS.index(entry)
                for entry in _ENTRIES.get(name, (name,))
                if entry in PARAMETERS
            ]
            relative = name in _STIFFNESS or "gain" in name
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
        raise InputError(
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
    _set_rod(document["rod"], calibration, source)
    _set_sensor(document["sensor"], calibration)
    if "object" in document:
        _set_object(document["object"], calibration)
    _set_files(document, source.parent.resolve(), file.parent.resolve())
    table = _table(
        calibration, source, recordings, date or datetime.now(UTC).replace(microsecond=0)
    )
    document.pop("calibration", None)
    document.add("calibration", _item(library, table))
    file.write_text(library.dumps(document), encoding="utf-8")
    return file


def _set_rod(
    table: MutableMapping[str, Any], calibration: "Calibration[Any]", source: Path
) -> None:
    rod = calibration.setup.rod
    match table["kind"]:
        case "cylinder":
            stiffness = {"youngs_modulus": rod.bending_stiffness / (np.pi / 4 * rod.radius**4)}
        case "uniform":
            stiffness = {"bending_stiffness": rod.bending_stiffness}
        case kind:
            raise InputError(
                f"{source}: rod.kind = {kind!r} cannot hold a calibrated rod; allowed are cylinder and uniform"
            )
    _change(table, {"length": rod.length} | stiffness)


def _set_sensor(table: MutableMapping[str, Any], calibration: "Calibration[Any]") -> None:
    sensor = calibration.setup.sensor
    _change(
        table,
        {
            "clamp_position": sensor.clamp_position.tolist(),
            "clamp_orientation": sensor.clamp_orientation.tolist(),
        },
    )
    if "gain" in table or set(sensor.gain) != {1.0}:
        _change(table, {"gain": list(sensor.gain)})


def _set_object(table: MutableMapping[str, Any], calibration: "Calibration[Any]") -> None:
    turn, move = calibration.pose
    if not {"object_position", "object_orientation"} & set(calibration.free):
        return
    rotation = Rotation.from_matrix(turn)
    before = Rotation.from_quat(list(table.get("rotation", NO_TURN)))
    translation = (
        rotation.apply(np.array(list(table.get("translation", ORIGIN)), dtype=float)) + move
    )
    _change(
        table,
        {"rotation": (rotation * before).as_quat().tolist(), "translation": translation.tolist()},
    )


def _change(table: MutableMapping[str, Any], values: dict[str, Any]) -> None:
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


def _item(library: Any, table: dict[str, Any]) -> Any:
    """A table in which each row of a matrix has its own line."""
    item = library.item(
        {
            name: value
            for name, value in table.items()
            if name not in _MATRICES and name != "estimates"
        }
    )
    for name in _MATRICES:
        array = library.array()
        for row in table[name]:
            array.add_line(row)
        if len(array):
            array.add_line(indent="")
        item.add(name, array)
    item.add("estimates", library.item(table["estimates"]))
    return item


_MATRICES = ("correlation", "tare", "drift")


def _table(
    calibration: "Calibration[Any]", source: Path, recordings: Sequence[str | Path], date: datetime
) -> dict[str, Any]:
    from vibrissa import __version__  # noqa: PLC0415

    found, known = calibration.fitness, calibration.identifiability
    estimates = {
        name: {"unit": one.unit, "given": one.given, "value": one.value}
        | ({"standard_deviation": one.deviation} if one.determined else {})
        for name, one in calibration.estimates.items()
    }
    return {
        "format": FORMAT,
        "vibrissa": __version__,
        "date": date,
        "recordings": [Path(recording).name for recording in recordings],
        "setup": source.name,
        "free": list(calibration.free),
        "friction": calibration.friction,
        "unevenness": float(f"{calibration.unevenness:.4g}"),
        "rows": int(np.count_nonzero(calibration.residuals.contact)),
        "reduced_chi_square": found.reduced_chi_square,
        "whiteness": found.whiteness,
        "inflation": [float(f"{factor:.4g}") for factor in found.inflation],
        "disturbed": float(f"{found.disturbed:.4g}"),
        "held_out": [float(f"{part.reduced_chi_square:.4g}") for part in calibration.held_out],
        "warnings": list(calibration.warnings),
        "not_determined": list(known.held),
        "names": list(known.names),
        "correlation": np.round(known.correlation, 9).tolist(),
        "tare": _rounded(calibration.tare),
        "drift": _rounded(calibration.drift),
        "estimates": estimates,
    }


def _rounded(values: np.ndarray) -> list[list[float]]:
    return [[float(f"{value:.5g}") for value in row] for row in values]
