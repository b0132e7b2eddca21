"""Colours of contacts, and what they mean."""

from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from jaxtyping import Float, UInt8

from vibrissa.contacts import ContactKind, Status
from vibrissa.drawing import KIND_COLOURS, KIND_NAMES
from vibrissa.viewer.content import Content, Rows

By: TypeAlias = Literal["kind", "status", "force", "uncertainty"]
MODES: tuple[By, ...] = get_args(By)

_SCALE = np.array(
    [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141],
     [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]]
)  # fmt: skip
"""Nine colours of viridis (van der Walt and Smith), evenly spaced."""
_SOUND, _UNKNOWN = "#4c9f70", "#808080"
_WRONG = ("#d1495b", "#edae49", "#7b4fa3", "#00798c", "#8c5e3c", "#e377c2", "#30638e", "#b5bd00")
"""Colours of other statuses than OK, in the order of their codes; repeated if there are more."""
_FAINT = 0.65
"""How much white is mixed into contacts that are not sound."""


class Legend(NamedTuple):
    """What colours mean: some by name, or a scale from a lowest to a highest number."""

    entries: tuple[tuple[str, str], ...]
    """Colour and text."""
    title: str
    scale: tuple[float, float] | None = None


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def modes_of(content: Content) -> tuple[By, ...]:
    """What contacts may be coloured by: force and uncertainty only if they are known."""
    rows = content.contacts
    known = {
        "force": np.isfinite(rows.force).any(),
        "uncertainty": np.isfinite(rows.deviation).any(),
    }
    return tuple(mode for mode in MODES if known.get(mode, True))


class Painter:
    """Gives contacts their colours; the range of a scale is that of the rows it is made from.

    Parameters
    ----------
    by
        What the colours show.
    rows
        All contacts.
    content
        Its units are those of the legend.
    """

    def __init__(self, by: By, rows: Rows, content: Content) -> None:
        self._by, self._range = by, (0.0, 1.0)
        unit = {"force": content.force_unit, "uncertainty": content.unit}.get(by, "")
        self._unit = f" [{unit}]" if unit else ""
        if by in ("force", "uncertainty"):
            values = _values(by, rows)
            values = values[np.isfinite(values)]
            if len(values):
                # A few wild ones would leave one colour for all others.
                low, high = np.percentile(values, [2, 98]).tolist()
                self._range = low, max(high, low + np.finfo(float).tiny)
        self.legend = self._legend(rows)

    def __call__(self, rows: Rows) -> UInt8[np.ndarray, "c 3"]:
        """Colours of contacts; those that are not sound are faint, unless it is the status that is
        shown.
        """
        if self._by == "status":
            return _by_code(rows.status, {code: _status_colour(code) for code in Status})
        if self._by == "kind":
            own = _by_code(rows.kind, KIND_COLOURS)
        else:
            low, high = self._range
            place = np.clip((_values(self._by, rows) - low) / (high - low), 0, 1)
            ticks = np.linspace(0, 1, len(_SCALE))
            own = np.stack([np.interp(place, ticks, part) for part in _SCALE.T], axis=1)
            own[np.isnan(place)] = rgb(_UNKNOWN)
        faint = rows.status[:, None] != Status.OK
        return np.where(faint, own + _FAINT * (255 - own.astype(float)), own).astype(np.uint8)

    def _legend(self, rows: Rows) -> Legend:
        faint = int((rows.status != Status.OK).sum())
        flagged = (("#dddddd", f"faint: status not OK ({faint})"),) if faint else ()
        if self._by == "kind":
            counted = [(kind, int((rows.kind == kind).sum())) for kind in KIND_COLOURS]
            named = tuple((KIND_COLOURS[k], f"{KIND_NAMES[k]} ({n})") for k, n in counted if n)
            return Legend(named + flagged, "kind of contact")
        if self._by == "status":
            codes, counts = np.unique(rows.status, return_counts=True)
            pairs = zip(map(Status, codes.tolist()), counts.tolist(), strict=True)
            return Legend(tuple((_status_colour(s), f"{s.name} ({n})") for s, n in pairs), "status")
        titles = {"force": "support force", "uncertainty": "standard deviation"}
        return Legend(flagged, titles[self._by] + self._unit, self._range)

    @staticmethod
    def gradient() -> list[str]:
        """Colours of the scale, evenly spaced."""
        return [f"rgb({red}, {green}, {blue})" for red, green, blue in _SCALE.tolist()]


def _values(by: By, rows: Rows) -> Float[np.ndarray, "c"]:
    return rows.force if by == "force" else rows.deviation


def _status_colour(code: Status) -> str:
    return _SOUND if code is Status.OK else _WRONG[(code - 1) % len(_WRONG)]


def _by_code(
    codes: np.ndarray, colours: dict[ContactKind, str] | dict[Status, str]
) -> UInt8[np.ndarray, "c 3"]:
    palette = np.full((len(Status), 3), rgb(_UNKNOWN), dtype=np.uint8)
    for code, colour in colours.items():
        palette[code] = rgb(colour)
    return np.asarray(palette[codes])
