"""What forward and inverse say about a position: the kind of contact, and whether the row can be
trusted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from vibrissa.brief import counts, point


class RecordingWarning(UserWarning):
    """A recording contradicts its setup, or part of it was left out, recovered or estimated."""


class RecordingNote(RecordingWarning):
    """What reading left out, recovered or estimated: the remaining contacts are as good as any."""


@dataclass(frozen=True, eq=False)
class Contacts:
    """Where something was touched: returned by scans, reconstructions, smoothing and live streams,
    or built by hand. Any shape of rows (…), in one unit of length.

    Attributes
    ----------
    point
        (…, 3); NaN on rows without contact.
    normal
        (…, 3) outward unit normal of the object, as far as it is known.
    force_direction
        (…, 3) unit vector of the contact force on the rod, or None.
    arc_length
        (…) of the contact from the clamp, or None.
    kind, status
        (…) values of `ContactKind` and `Status`, or None.
    covariance, normal_covariance
        (…, 3, 3) of point and normal, or None.
    cross_covariance
        (…, 3, 3) of point (rows) with normal (columns), or None.
    time
        (…) [s], or None.
    sweep
        (…) which sweep a row belongs to, counted from 0, or None for a single one.

    Raises
    ------
    ValueError
        If a shape does not match that of the points, a normal is not of unit length, or a sweep,
        kind or status is no whole number.
    """

    point: Float[np.ndarray, "*rows 3"]
    normal: Float[np.ndarray, "*rows 3"]
    covariance: Float[np.ndarray, "*rows 3 3"] | None = None
    normal_covariance: Float[np.ndarray, "*rows 3 3"] | None = None
    sweep: Int[np.ndarray, "*rows"] | None = None
    time: Float[np.ndarray, "*rows"] | None = None
    kind: Int[np.ndarray, "*rows"] | None = None
    force_direction: Float[np.ndarray, "*rows 3"] | None = None
    arc_length: Float[np.ndarray, "*rows"] | None = None
    status: Int[np.ndarray, "*rows"] | None = None
    cross_covariance: Float[np.ndarray, "*rows 3 3"] | None = None

    def __init__(
        self,
        point: ArrayLike,
        normal: ArrayLike,
        covariance: ArrayLike | None = None,
        normal_covariance: ArrayLike | None = None,
        sweep: ArrayLike | None = None,
        time: ArrayLike | None = None,
        kind: ArrayLike | None = None,
        force_direction: ArrayLike | None = None,
        arc_length: ArrayLike | None = None,
        status: ArrayLike | None = None,
        cross_covariance: ArrayLike | None = None,
    ) -> None:
        given, rows = locals(), np.shape(point)[:-1]
        for field in fields(self):
            name = field.name
            value, shape = given[name], rows + _SHAPES.get(name, ())
            if value is not None:
                value = _whole(name, value) if name in _WHOLE else np.asarray(value, np.float64)
                if value.shape != shape:
                    raise ValueError(
                        f"{name} has shape {value.shape}; allowed is {shape}, as point has"
                    )
            vars(self)[name] = value
        length = np.linalg.norm(self.normal, axis=-1)
        wrong = np.abs(length - 1) > _UNIT
        if wrong.any():
            row = tuple(map(int, np.argwhere(wrong)[0]))
            raise ValueError(f"normal{list(row)} has length {length[row]:.6g}; allowed is 1")

    @classmethod
    def of(cls, result: Any, time: ArrayLike | None) -> Contacts:
        """Contacts of a result, by the names of its fields: each of several trails is a sweep."""
        rows = np.shape(result.kind)
        return cls(
            **{each.name: getattr(result, each.name, None) for each in fields(cls)}
            | {"time": time, "sweep": np.indices(rows)[0] if len(rows) > 1 else None}
        )

    @classmethod
    def joined(cls, parts: Sequence[Contacts]) -> Contacts:
        """Contacts of several sweeps or sessions one after another (n, …), sweeps numbered through;
        without what one of them lacks. They may come from different rods and mounts, as long as
        their axes and unit of length are the same.

        Raises
        ------
        ValueError
            If there are none.
        """
        if not len(parts):
            raise ValueError("parts is empty; allowed is at least one")
        sweeps, first = [], 0
        for part in parts:
            rows = part.point[..., 0].size
            own = np.zeros(rows, int) if part.sweep is None else part.sweep.reshape(-1)
            numbers = np.unique(own, return_inverse=True)[1]
            sweeps.append(first + numbers)
            first += int(numbers.max(initial=-1)) + 1
        given: dict[str, Any] = {"sweep": np.concatenate(sweeps)}
        for name in [field.name for field in fields(cls) if field.name != "sweep"]:
            columns = [getattr(part, name) for part in parts]
            if all(column is not None for column in columns):
                shape = _SHAPES.get(name, ())
                given[name] = np.concatenate([column.reshape(-1, *shape) for column in columns])
        return cls(**given)

    def __repr__(self) -> str:
        """Return up to five lines: rows, kinds, statuses, extent, and what else is known."""
        known = np.isfinite(self.point).all(axis=-1)
        lines = [f"Contacts in {known.sum()} of {known.size} rows {known.shape}"]
        if self.kind is not None:
            lines.append(f"  kind: {counts(self.kind, ContactKind)}")
        if self.status is not None:
            lines.append(f"  status: {counts(self.status, Status)}")
        if known.any():
            corners = (edge(self.point[known], axis=0) for edge in (np.min, np.max))
            lines.append(f"  from {' to '.join(map(point, corners))}")
        more = [name for name in list(vars(self))[2:] if name not in ("kind", "status")]
        given = [name for name in more if getattr(self, name) is not None]
        return "\n".join([*lines, f"  with: {', '.join(given) or 'nothing else'}"])

    def __getitem__(self, rows: Any) -> "Contacts":
        """Return the chosen rows, all fields together."""
        return Contacts(
            **{name: part[rows] for name, part in vars(self).items() if part is not None}
        )

    def __len__(self) -> int:
        """Rows along the first axis."""
        return len(self.point)


_SHAPES: dict[str, tuple[int, ...]] = {
    "point": (3,),
    "normal": (3,),
    "force_direction": (3,),
    "covariance": (3, 3),
    "normal_covariance": (3, 3),
    "cross_covariance": (3, 3),
}
"""Shape of a row's value, where it is not a scalar."""
_WHOLE = ("sweep", "kind", "status")
"""Fields whose values are whole numbers."""


def _whole(name: str, value: ArrayLike) -> Int[np.ndarray, "..."]:
    given = np.asarray(value)
    with np.errstate(invalid="ignore"):
        found = given.astype(np.int64)
    wrong = np.argwhere(found != given)
    if len(wrong):
        row = tuple(map(int, wrong[0]))
        raise ValueError(f"{name}{list(row)} = {given[row]}; allowed are whole numbers")
    return found


_UNIT = 1e-6
"""Allowed error of a unit vector's length: that of files in single precision."""


class ContactKind(IntEnum):
    """How the rod touches the object (paper, section II)."""

    NONE = 0
    TIP = 1
    TANGENTIAL = 2


class Motion(IntEnum):
    """How the contact moves on the way to a position: the rod's material point rests on the object
    or slides over it.
    """

    NONE = 0
    STICK = 1
    SLIP = 2
    ROLL = 3
    """At rest like STICK, while the contact moves along rod and object alike."""


class Status(IntEnum):
    """Whether a row can be trusted; `text` says what is wrong and what to do. The worst finding
    wins.
    """

    OK = 0
    OVERSTRAINED = 1
    LATERALLY_UNSTABLE = 2
    PENETRATING = 3
    HEAD_ON = 4
    NOT_CONVERGED = 5
    NO_EQUILIBRIUM = 6
    CLAMP_INSIDE = 7
    NOT_SINGLE_CONTACT = 8
    BEYOND_TIP = 9
    NO_CURVATURE_ZERO = 10
    STEEP_TANGENT = 11
    BAD_DATA = 12
    NOT_UNIQUE = 13
    SETUP_CONTRADICTED = 14
    AMBIGUOUS = 15
    RINGING = 16
    TOUCHES_TWICE = 17
    FALLS_OVER = 18

    @property
    def text(self) -> str:
        """One sentence: what the row's finding means and what to do about it."""
        return _TEXTS[self]


_TEXTS = {
    Status.OK: "All checks passed.",
    Status.OVERSTRAINED: (
        "The largest bending strain exceeds the rod's yield strain; take a thinner or longer "
        "rod, or move the clamp away from the object."
    ),
    Status.LATERALLY_UNSTABLE: (
        "The equilibrium is unstable, a real rod leaves its bending plane here; offset the trail "
        "a little to follow the stable branch."
    ),
    Status.PENETRATING: (
        "The rod also touches the object, at `second_contact`, or passes through it there: its "
        "reactions are not those of a single contact."
    ),
    Status.HEAD_ON: (
        "The contact force acts along the clamp's axis and a straight rod: nothing determines to "
        "which side the rod buckles or stays bent; offset or tilt the clamp."
    ),
    Status.NOT_CONVERGED: (
        "The equations could not be solved to their tolerance; refine the trail, check the level "
        "function's smoothness, or ask for a smaller `accuracy`."
    ),
    Status.NO_EQUILIBRIUM: (
        "No admissible equilibrium with a single contact was found; the rod may be jammed, or "
        "touch in more than one place."
    ),
    Status.CLAMP_INSIDE: "The clamp lies inside the object; move the trail out of it.",
    Status.NOT_SINGLE_CONTACT: (
        "Force and moment do not belong to one contact force (m0·f0 ≠ 0 beyond the noise, once "
        "known loads are taken off); check the tare, the mount, or for a second contact."
    ),
    Status.BEYOND_TIP: (
        "The rod is first free of moment beyond its tip; check the rod's length and stiffness, the "
        "tare and the mount."
    ),
    Status.NO_CURVATURE_ZERO: (
        "Nowhere along the rod is it free of moment under these reactions, so no single contact "
        "explains them; check the rod, the tare and the sign of the wrench."
    ),
    Status.STEEP_TANGENT: (
        "Force and rod meet at an angle that no friction explains: the rod would come out of the "
        "object, or be pushed back along itself before its tip; check the sign of the wrench and "
        "the rod."
    ),
    Status.BAD_DATA: "The row holds numbers that are not finite; check the recording.",
    Status.NOT_UNIQUE: (
        "More than one contact explains the reactions that were used: `candidates` lists those on "
        "a curved rod, and smoothing follows the one that continues the sweep; of fewer than six "
        "channels, add some."
    ),
    Status.SETUP_CONTRADICTED: (
        "The sweep contradicts the setup by more than the error bar of this contact; see the "
        "warnings, then calibrate or state [tolerances]."
    ),
    Status.AMBIGUOUS: (
        "Smoothing cannot tell here which phase, start or branch is the right one, and they lie "
        "apart, or the contact moves too fast for it; use the raw contact, a stronger signal, or a "
        "slower sweep."
    ),
    Status.RINGING: (
        "The rod swings freely after it was released; these loads are its inertia, not a contact."
    ),
    Status.FALLS_OVER: (
        "No stable shape of the rod without contact was found under its weight and the wind here; "
        "take a stiffer or shorter rod, or smaller loads."
    ),
    Status.TOUCHES_TWICE: (
        "No single contact has this force and moment, while the rest of the sweep agrees with "
        "the setup: the rod touches two places, or is caught."
    ),
}
