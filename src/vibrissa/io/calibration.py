"""A calibrated setup as a file: the original setup with the calibrated numbers, and their
uncertainties in a table [calibration].
"""

import os
from collections.abc import MutableMapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from vibrissa.files import InputError, readable, writable
from vibrissa.io.calibration_report import summary
from vibrissa.io.config import NO_TURN, ORIGIN, Finite, NotNegative, Table, number
from vibrissa.io.rod import rod_of
from vibrissa.libraries import extra_library
from vibrissa.rod import Rod
from vibrissa.tolerances import PARAMETERS

if TYPE_CHECKING:
    from vibrissa.calibration import Calibration

FORMAT = 1
"""Version of the [calibration] table."""
_CHANNELS = 6
_STIFFNESS = ("youngs_modulus", "bending_stiffness")
_ENTRIES = dict.fromkeys(_STIFFNESS, ("bending_stiffness",)) | {
    f"{kind}_gain": tuple(f"gain_{kind}_{axis}" for axis in "xyz") for kind in ("force", "torque")
}
"""Entries of `vibrissa.tolerances.PARAMETERS` that calibrations name differently."""

Text = Annotated[str, Field(description="text")]
Names = Annotated[list[str], Field(description="a list of names")]
Numbers = Annotated[list[NotNegative], Field(description="a list of numbers of at least 0")]
Matrix = Annotated[list[list[Finite]], Field(description="rows of finite numbers")]


class EstimateTable(Table):
    """One calibrated number, in its own unit."""

    unit: Text
    given: Finite
    value: Finite
    standard_deviation: NotNegative | None = None
    holds_for: Names | None = None


class CalibrationTable(Table):
    """What is known about a calibrated setup's numbers; `tare` and `drift` have a row of six for
    each recording.
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
        """Names refer to estimates, and matrices have matching sizes."""
        for place, name in enumerate(self.names):
            if name not in self.estimates or name in self.names[:place]:
                raise ValueError(
                    f"names[{place}] = {name!r}; "
                    f"allowed is each once of {', '.join(self.estimates)}"
                )
        count, recordings = len(self.names), len(self.tare)
        for key, matrix, rows, columns in (
            ("correlation", self.correlation, count, count),
            ("tare", self.tare, recordings, _CHANNELS),
            ("drift", self.drift, recordings, _CHANNELS),
            ("inflation", [self.inflation], 1, _CHANNELS),
        ):
            lengths = [len(row) for row in matrix]
            if lengths != [columns] * rows:
                raise ValueError(
                    f"{key} has {len(matrix)} rows of {sorted({*lengths})} numbers; "
                    f"allowed are {rows} of {columns}"
                )
        return self

    def covariance(self) -> Float[np.ndarray, "names names"]:
        """Covariance of the numbers listed in `names`, in their units."""
        deviations = [self.estimates[name].standard_deviation or 0.0 for name in self.names]
        size = len(deviations)
        return np.reshape(self.correlation, (size, size)) * np.outer(deviations, deviations)

    def parameter_covariance(
        self, stated: Float[np.ndarray, "parameters parameters"]
    ) -> Float[np.ndarray, "parameters parameters"]:
        """Covariance of the errors of `vibrissa.tolerances.PARAMETERS`: the calibration's own for
        those that it determined, as stated for the others.
        """
        of_names = np.zeros((len(PARAMETERS), len(self.names)))
        for column, name in enumerate(self.names):
            relative = name in _STIFFNESS or "gain" in name
            rows = np.isin(PARAMETERS, _ENTRIES.get(name, (name,)))
            of_names[rows, column] = 1 / self.estimates[name].value if relative else 1.0
        own = np.any(of_names != 0, axis=1, keepdims=True)
        result = np.where(own | own.T, 0.0, stated)
        return np.asarray(result + of_names @ self.covariance() @ of_names.T)


def source_document(path: str | Path) -> Any:
    """Parse a setup file with `tomlkit`, so that numbers can be changed and all else kept.

    Raises
    ------
    InputError
        If tomlkit is not installed (the message gives the install command), or the setup cannot
        hold a calibrated rod.
    """
    try:
        library = extra_library(
            "tomlkit", extra="calibrate", need="writing a calibrated setup needs it"
        )
    except ImportError as error:
        raise InputError(str(error)) from error
    document = library.parse(readable(Path(path)).read_text(encoding="utf-8"))
    if document["rod"]["kind"] == "unit":
        raise InputError(
            f"{path}: rod.kind = 'unit' cannot hold a calibrated rod; allowed is any other kind"
        )
    return document


def write_calibration(
    path: str | Path,
    calibration: "Calibration[Any]",
    setup: str | Path,
    recordings: Sequence[str | Path] = (),
    *,
    date: datetime | None = None,
) -> Path:
    """Write a setup that the other commands accept: the file `setup` with the calibrated numbers
    and a table [calibration].

    Parameters
    ----------
    path
        TOML file to write; it may be `setup` itself.
    calibration
        The calibration of that setup.
    setup
        The setup file. Its comments and all that was not calibrated are kept.
    recordings
        Recordings, whose names are noted.
    date
        Date to note; now by default.

    Raises
    ------
    InputError
        If a file cannot be read or written, the setup's rod is in the model's units or cannot hold
        a taper that was found, or tomlkit is not installed.
    """
    from vibrissa import __version__  # noqa: PLC0415

    document, file = source_document(setup), writable(Path(path))
    _set_numbers(document, calibration)
    folders = Path(setup).parent.resolve(), file.parent.resolve()
    if folders[0] != folders[1]:
        set_files(document, *folders)
    found = summary(calibration) | {
        "format": FORMAT,
        "vibrissa": __version__,
        "date": date or datetime.now(UTC).replace(microsecond=0),
        "recordings": [Path(recording).name for recording in recordings],
        "setup": Path(setup).name,
    }
    found["inflation"] = found["variance_inflation"]
    found["held_out"] = [part["reduced_chi_square"] for part in found["held_out"]]
    found["not_determined"] = list(found["not_determined"])
    found["estimates"] = {
        name: {key: one[key] for key in EstimateTable.model_fields if one[key] is not None}
        for name, one in found["estimates"].items()
    }
    document.pop("calibration", None)
    document["calibration"] = {name: found[name] for name in CalibrationTable.model_fields}
    for matrix in ("correlation", "tare", "drift"):
        document["calibration"][matrix].multiline(multiline=True)
    file.write_text(document.as_string(), encoding="utf-8")
    return file


def _set_numbers(document: Any, calibration: "Calibration[Any]") -> None:
    sensor = calibration.setup.sensor
    _set_form(document["rod"], calibration)
    _scale_rod(document["rod"], calibration.setup.rod)
    names = ("clamp_position", "clamp_orientation", "gain")
    _change(document["sensor"], **{name: getattr(sensor, name) for name in names})
    if "object" in document and {"object_position", "object_orientation"} & set(calibration.free):
        table, (turn, move) = document["object"], calibration.pose
        rotation = Rotation.from_matrix(turn)
        before = Rotation.from_quat(table.get("rotation", NO_TURN))
        place = rotation.apply(table.get("translation", ORIGIN)) + move
        _change(table, rotation=(rotation * before).as_quat(), translation=place)


def _set_form(table: Any, calibration: "Calibration[Any]") -> None:
    """Write taper, rest curvature and a pivot's stiffness, if found."""
    rod = calibration.setup.rod
    found = {name for name, one in calibration.estimates.items() if one.determined}
    # Lengths in the file are those at the rod's own temperature, and so before it stretches.
    stretch = rod_of(table.unwrap()).length / _own_length(table)
    if found & {"taper", "tip_radius"}:
        if table["kind"] not in ("cylinder", "tapered"):
            raise InputError(
                f"rod.kind = {table['kind']!r} cannot hold a taper; allowed are cylinder and "
                "tapered"
            )
        if table["kind"] == "cylinder":
            table["kind"] = "tapered"
            table["base_radius"] = table.pop("radius")
        table["tip_radius"] = float(rod.radius_at(1.0)) / stretch
    if "rest_curvature" in found:
        curvature, roll = float(rod.rest.coefficients[0]) * stretch, float(rod.rest.roll)
        table["rest"] = {"kind": "polynomial", "coefficients": [curvature], "roll": roll}
    if any(name.startswith("support_stiffness") for name in found):
        table["support"]["stiffness"] = np.asarray(rod.support.stiffness).tolist()


def _own_length(table: Any) -> float:
    return float(table["length"] if "length" in table else table["arc_length"][-1])


_STIFFNESS_KEYS = (*_STIFFNESS, "torsional_stiffness")
_LENGTH_KEYS = ("length", "arc_length")


def _scale_rod(table: Any, rod: Rod) -> None:
    """Change what the table of a rod says about stiffness and length by as much as the rod it
    describes, perhaps at a temperature, differs from the given one.
    """
    before = rod_of(table.unwrap())
    for keys, new, old in (
        (_STIFFNESS_KEYS, rod.bending_stiffness, before.bending_stiffness),
        (_LENGTH_KEYS, rod.length, before.length),
    ):
        given = {key: np.asarray(table[key], dtype=float) for key in keys if key in table}
        _change(table, **{key: new * (value / old) for key, value in given.items()})


_LEFT_OUT = {"gain": (1.0,) * _CHANNELS, "rotation": NO_TURN, "translation": ORIGIN}
"""Values that apply where a setup does not state them."""


def _change(table: MutableMapping[str, Any], **values: Any) -> None:
    """Set values that differ by more than rounding: unchanged ones keep their digits."""
    for name, value in values.items():
        old = np.array(table.get(name, _LEFT_OUT.get(name)), dtype=float)
        if not np.allclose(old, value, rtol=1e-14, atol=0):
            table[name] = np.asarray(value).tolist()


def set_files(value: Any, old: Path, new: Path) -> None:
    """Adapt paths of meshes and motions: they are relative to the TOML file that names them."""
    table = dict(enumerate(value)) if isinstance(value, list) else value
    for key, part in dict(table if isinstance(table, MutableMapping) else {}).items():
        if key not in {"file", "path"}:
            set_files(part, old, new)
        elif not Path(part).is_absolute():
            value[key] = Path(os.path.relpath(old / part, new)).as_posix()
