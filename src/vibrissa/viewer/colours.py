"""Colours of contacts and fitted surfaces, and what they mean."""

from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from jaxtyping import Float, UInt8

from vibrissa.contacts import ContactKind, Status
from vibrissa.drawing import KIND_COLOURS, KIND_NAMES
from vibrissa.viewer.content import Content, Fitted, Rows

By: TypeAlias = Literal["kind", "status", "force", "uncertainty"]
MODES: tuple[By, ...] = get_args(By)

_SCALE = np.array(
    [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141],
     [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]]
)  # fmt: skip
"""Nine colours of viridis (van der Walt and Smith), evenly spaced."""
OUTLIER = "#ff00c8"
"""Far from all colours of kinds and of viridis."""
_SOUND, _UNKNOWN = "#4c9f70", "#808080"
_WRONG = ("#d1495b", "#edae49", "#7b4fa3", "#00798c", "#8c5e3c", "#e377c2", "#30638e", "#b5bd00")
"""Colours of other statuses than OK, in the order of their codes; repeated if there are more."""
_FAINT = 0.65
"""How much white is mixed into contacts that are not sound."""


class Scale(NamedTuple):
    """Numbers as colours, from a lowest to a highest one; those beyond take the colours of the
    ends.
    """

    low: float
    high: float
    falling: bool
    """Whether low ones are bright: deviations, so that what is known well stands out."""
    logarithmic: bool = False

    def place(self, values: Float[np.ndarray, "*rows"]) -> Float[np.ndarray, "*rows"]:
        """Where values lie along the scale, from 0 to 1."""
        low, high = self.low, self.high
        if self.logarithmic:
            low, high, values = np.log(low), np.log(high), np.log(values)
        return np.asarray(np.clip((values - low) / (high - low), 0, 1))

    def colours(self, place: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
        """Colours along the scale, 0 to 255."""
        ticks = np.linspace(0, 1, len(_SCALE))
        own = _SCALE[::-1] if self.falling else _SCALE
        return np.stack([np.interp(place, ticks, part) for part in own.T], axis=1)

    @property
    def middle(self) -> float:
        """The number half-way along."""
        mean = np.sqrt(self.low * self.high) if self.logarithmic else (self.low + self.high) / 2
        return float(mean)


class Legend(NamedTuple):
    """What colours mean: some by name, or a scale from a lowest to a highest number."""

    entries: tuple[tuple[str, str], ...]
    """Colour and text."""
    title: str
    scale: Scale | None = None


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
        self._by, self._scale = by, Scale(0.0, 1.0, by == "uncertainty")
        unit = {"force": content.force_unit, "uncertainty": content.unit}.get(by, "")
        self._unit = f" [{unit}]" if unit else ""
        if by in ("force", "uncertainty"):
            values = _values(by, rows)
            values = values[np.isfinite(values)]
            if len(values):
                # A few wild ones would leave one colour for all others.
                low, high = np.percentile(values, [2, 98]).tolist()
                high = max(high, low + np.finfo(float).tiny)
                self._scale = self._scale._replace(low=low, high=high)
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
            place = self._scale.place(_values(self._by, rows))
            own = self._scale.colours(place)
            own[np.isnan(place)] = rgb(_UNKNOWN)
        faint = rows.status[:, None] != Status.OK
        return np.where(faint, own + _FAINT * (255 - own.astype(float)), own).astype(np.uint8)

    def _legend(self, rows: Rows) -> Legend:
        faint = int((rows.status != Status.OK).sum())
        flagged = (("#dddddd", f"faint: status not OK ({faint})"),) if faint else ()
        if self._by == "kind":
            counted = [(kind, int((rows.kind == kind).sum())) for kind in KIND_COLOURS]
            named = [(KIND_COLOURS[k], f"{KIND_NAMES[k]} ({n})") for k, n in counted if n]
            if unknown := int((rows.kind == ContactKind.NONE).sum()):
                named.append((_UNKNOWN, f"not known ({unknown})"))
            return Legend((*named, *flagged), "kind of contact")
        if self._by == "status":
            codes, counts = np.unique(rows.status, return_counts=True)
            pairs = zip(map(Status, codes.tolist()), counts.tolist(), strict=True)
            return Legend(tuple((_status_colour(s), f"{s.name} ({n})") for s, n in pairs), "status")
        titles = {"force": "support force", "uncertainty": "standard deviation"}
        return Legend(flagged, titles[self._by] + self._unit, self._scale)


def surface_legend(fitted: Sequence[Fitted], unit: str) -> Legend:
    """What the colours of fitted surfaces mean: one scale for all, that of `plot.shape_figure`."""
    deviation = np.concatenate([one.deviation for one in fitted])
    low, high = np.quantile(deviation, (0.02, 0.98)).tolist()
    scale = Scale(low, max(high, 1.5 * low), falling=True, logarithmic=True)
    outliers = sum(len(one.outlier) for one in fitted)
    entries = ((OUTLIER, f"contact that it contradicts ({outliers})"),) if outliers else ()
    return Legend(entries, f"standard deviation [{unit}]", scale)


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
