"""What a page shows, as plain numbers in the unit in which it is shown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

SAMPLES = 40
"""Points of a drawn rod: its pieces are a few pixels long."""
WIDE = 0.1
"""Error of a contact, in rod lengths, from which it says little."""
MILLIMETRES = 1e3
"""In a metre."""
UNKNOWN = ""
"""Unit of contacts whose file does not say it."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Contacts (c, …), one after another.

    Attributes
    ----------
    point, normal
        (c, 3).
    kind, status
        (c,) values of `vibrissa.ContactKind` and `vibrissa.Status`.
    arc_length, time, force
        (c,) from the clamp, [s], and of the support force; NaN where unknown.
    covariance
        (c, 3, 3) of the points; NaN where unknown.
    """

    point: Float[np.ndarray, "c 3"]
    normal: Float[np.ndarray, "c 3"]
    kind: Int[np.ndarray, "c"]
    status: Int[np.ndarray, "c"]
    arc_length: Float[np.ndarray, "c"]
    time: Float[np.ndarray, "c"]
    force: Float[np.ndarray, "c"]
    covariance: Float[np.ndarray, "c 3 3"]

    def __len__(self) -> int:
        """How many."""
        return len(self.kind)

    def __getitem__(self, rows: "slice | np.ndarray") -> "Rows":
        """Return some of them."""
        return Rows(*(getattr(self, each.name)[rows] for each in fields(self)))

    @property
    def deviation(self) -> Float[np.ndarray, "c"]:
        """Standard deviation (c,) of the whole vector; NaN where unknown."""
        return np.sqrt(np.trace(self.covariance, axis1=1, axis2=2))

    @classmethod
    def joined(cls, parts: "Sequence[Rows]") -> "Rows":
        """All of several, at least one."""
        names = [each.name for each in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @classmethod
    def none(cls) -> "Rows":
        """No contact."""
        numbers, codes = np.zeros(0), np.zeros(0, dtype=int)
        vectors = np.zeros((0, 3))
        return cls(vectors, vectors, codes, codes, numbers, numbers, numbers, np.zeros((0, 3, 3)))


class Fitted(NamedTuple):
    """A fitted surface where it is known, with standard deviations (v,) at its vertices (v, 3)."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normal: Float[np.ndarray, "v 3"]
    deviation: Float[np.ndarray, "v"]
    outlier: Float[np.ndarray, "o 3"]
    """Contacts that it contradicts."""


class Instant(NamedTuple):
    """One position of the time slider."""

    label: str
    rods: Mapping[str, Float[np.ndarray, "pieces 2 3"]]
    """Begin and end of each piece of the rods, by colour."""
    contacts: Rows
    """Those that came since the instant before."""


class Pose(NamedTuple):
    """Axes of a frame, such as that of the sensor."""

    name: str
    position: Float[np.ndarray, "3"]
    orientation: Float[np.ndarray, "4"]
    """x y z w."""


@dataclass(frozen=True, eq=False)
class Content:
    """What a page shows.

    Attributes
    ----------
    unit, force_unit
        Of lengths and forces as shown: "mm" and "N", "L" and "EI/L²", or "" if unknown.
    size
        Length by which markers are scaled: that of the rod, or the extent of the contacts.
    triangles
        (f, 3, 3) of the object; none if it is not known.
    trails
        Paths (n, 3) of the clamp.
    poses
        Frames that are drawn.
    instants
        From first to last; none if nothing moves.
    notes
        What is left out, one line each.
    room
        Kept free around all there is, for what is to come.
    fitted
        Surfaces fitted to contacts.
    """

    unit: str
    force_unit: str
    size: float
    triangles: Float[np.ndarray, "f 3 3"]
    trails: tuple[Float[np.ndarray, "_ 3"], ...] = ()
    poses: tuple[Pose, ...] = ()
    instants: tuple[Instant, ...] = ()
    notes: tuple[str, ...] = ()
    room: float = 0.0
    fitted: tuple[Fitted, ...] = ()

    @property
    def contacts(self) -> Rows:
        """All contacts, as they came."""
        return Rows.joined([Rows.none(), *(instant.contacts for instant in self.instants)])

    @property
    def box(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Least and largest coordinates of all there is, and of the room around it."""
        rods = [rod for instant in self.instants for rod in instant.rods.values()]
        poses = [pose.position for pose in self.poses]
        contacts = self.contacts
        # Contacts that could be anywhere do not decide what is shown, if there is anything else.
        sound = contacts[~(contacts.deviation > WIDE * self.size)]
        fitted = [one.vertices for one in self.fitted]
        parts = [self.triangles, *fitted, *self.trails, *rods, sound.point, *poses]
        if not sum(part.size for part in parts):
            parts = [contacts.point]
        points = np.concatenate([part.reshape(-1, 3) for part in parts])
        if not len(points):
            raise ValueError("nothing to show: no object, no rod and no contact")
        return points.min(axis=0) - self.room, points.max(axis=0) + self.room


def joined(contents: Sequence[Content]) -> Content:
    """All of several on one page: their sweeps run side by side, from begin to end.

    Raises
    ------
    ValueError
        If nothing is given, or lengths are in different units.
    """
    if not contents:
        raise ValueError("nothing to show; allowed is at least one result or file")
    units = sorted({one.unit for one in contents} - {UNKNOWN})
    if len(units) > 1:
        raise ValueError(
            f"lengths in {' and in '.join(units)} on one page; allowed is one unit for all"
        )
    if units == ["mm"]:
        contents = [one if one.unit else in_millimetres(one) for one in contents]
    first = max(contents, key=lambda one: bool(one.unit))
    count = max(len(one.instants) for one in contents)
    return replace(
        first,
        size=max(one.size for one in contents),
        triangles=np.concatenate([one.triangles for one in contents]),
        trails=tuple(trail for one in contents for trail in one.trails),
        poses=tuple(pose for one in contents for pose in one.poses),
        instants=tuple(_side_by_side(contents, number, count) for number in range(count)),
        notes=tuple(note for one in contents for note in one.notes),
        fitted=tuple(fitted for one in contents for fitted in one.fitted),
    )


def in_millimetres(content: Content) -> Content:
    """Contacts without a unit, which files hold in metres, in millimetres."""

    def scaled(rows: Rows) -> Rows:
        return replace(
            rows,
            point=MILLIMETRES * rows.point,
            arc_length=MILLIMETRES * rows.arc_length,
            covariance=MILLIMETRES**2 * rows.covariance,
        )

    return replace(
        content,
        unit="mm",
        size=MILLIMETRES * content.size,
        instants=tuple(one._replace(contacts=scaled(one.contacts)) for one in content.instants),
    )


def _side_by_side(contents: Sequence[Content], number: int, count: int) -> Instant:
    """One of `count` instants of several contents, each spread over all of them."""
    labels: list[str] = []
    rods: dict[str, list[Float[np.ndarray, "pieces 2 3"]]] = {}
    contacts = [Rows.none()]
    for one in contents:
        own = len(one.instants)
        if not own:
            continue
        before = number * own // count
        here = min((number + 1) * own // count, own)
        contacts += [instant.contacts for instant in one.instants[before:here]]
        shown = one.instants[max(here - 1, 0)]
        labels.append(shown.label)
        for colour, pieces in shown.rods.items():
            rods.setdefault(colour, []).append(pieces)
    # Labels of different sweeps would contradict each other.
    label = labels[0] if len(set(labels)) == 1 else f"{100 * (number + 1) / count:.0f} %"
    return Instant(
        label,
        {colour: np.concatenate(parts) for colour, parts in rods.items()},
        Rows.joined(contacts),
    )
