"""Long recordings are smoothed in segments, so that memory is bounded and time grows with the
samples: cut at rest, or overlapping within a contact.
"""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from vibrissa.contacts import ContactKind
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.smoothing.fit import TARED
from vibrissa.inverse.smoothing.kalman import Gaussian
from vibrissa.inverse.smoothing.phases import runs_of
from vibrissa.inverse.smoothing.result import Smoothing, Touch
from vibrissa.inverse.smoothing.series import Flags
from vibrissa.trail import Trail

_LONGEST, _OVERLAP = 16384, 2048
"""Samples: some hundred MB of states, and an overlap in whose middle a cut is not felt."""
_REST = 128
"""Samples without contact in the middle of which two segments may meet."""


class Segment(NamedTuple):
    """Rows smoothed together, from `first` to before `stop`, and those of them that are kept."""

    first: int
    stop: int
    kept: slice


class Piece(NamedTuple):
    """A segment, smoothed, and the sensor's zero at the row at which the next one begins."""

    found: Reconstruction
    zero: Gaussian


def rows_of(found: Reconstruction) -> dict[str, Any]:
    """Fields of a reconstruction that hold one entry a sample."""
    given = {field.name: getattr(found, field.name) for field in fields(found)}
    return {name: value for name, value in given.items() if isinstance(value, np.ndarray)}


def in_segments(
    found: Reconstruction,
    run: Callable[[Reconstruction, Gaussian, int], Piece],
    progress: Callable[[int, int], None] | None = None,
) -> Reconstruction:
    """Smooth one trail; `run` is given a segment, the zero at its beginning, and the row of it at
    which the next one begins.
    """
    segments, zero = _segments_of(found.kind == ContactKind.NONE), TARED
    if len(segments) == 1:
        return run(found, zero, len(found.kind) - 1).found
    pieces = []
    for segment, following in zip(segments, [*segments[1:], None], strict=True):
        end = min(following.first if following else segment.stop, segment.stop - 1)
        piece, zero = run(_part_of(found, segment), zero, end - segment.first)
        pieces.append(_kept(piece, segment))
        if progress is not None:
            progress(segment.kept.stop, len(found.kind))
    parts = [piece.smoothing[0] for piece in pieces if piece.smoothing]
    rows: dict[str, Any] = {
        name: np.concatenate([getattr(piece, name) for piece in pieces])
        for name in rows_of(pieces[0])
    }
    return replace(found, **rows, smoothing=(_joined(parts),))


def _segments_of(resting: Flags) -> list[Segment]:
    count, low, kept, segments = len(resting), 0, 0, []
    while count - low > _LONGEST:
        high, middle = low + _LONGEST, low + _LONGEST // 2
        stop, cut, following = high, high - _OVERLAP // 2, high - _OVERLAP
        rests = [run for run in runs_of(resting[middle:high]) if run[1] - run[0] >= _REST]
        if rests:
            longest = max(rests, key=lambda run: (run[1] - run[0], run[0]))
            stop = cut = following = middle + sum(longest) // 2
        segments.append(Segment(low, stop, slice(kept, cut)))
        low, kept = following, cut
    return [*segments, Segment(low, count, slice(kept, count))]


def _part_of(found: Reconstruction, segment: Segment) -> Reconstruction:
    """The rows of a segment."""
    given, rows = found.reactions, slice(segment.first, segment.stop)
    each: dict[str, Any] = {
        name: None if value is None else value[rows]
        for name, value in (
            ("force", given.force),
            ("moment", given.moment),
            ("time", np.arange(len(found.kind), dtype=float) if given.time is None else given.time),
            ("rotation_center", given.rotation_center),
            ("velocity", given.velocity),
        )
    }
    covariance = given.covariance
    if covariance is not None and covariance.ndim > 2:
        each["covariance"] = covariance[rows]
    trail = Trail(given.trail.position[rows], given.trail.orientation[rows])
    parts = {name: value[rows] for name, value in rows_of(found).items()}
    return replace(found, reactions=replace(given, trail=trail, **each), **parts)


def _kept(piece: Reconstruction, segment: Segment) -> Reconstruction:
    """Only the rows that are kept, copied, so that those of the overlap are freed; contacts with
    rows of the whole recording.
    """
    rows = slice(segment.kept.start - segment.first, segment.kept.stop - segment.first)
    parts: dict[str, Any] = {name: value[rows].copy() for name, value in rows_of(piece).items()}
    assert piece.smoothing is not None
    smoothing = piece.smoothing[0]
    each = {name: getattr(smoothing, name)[rows].copy() for name in ("drift", "weight", "tilt")}
    touches = [_cut(touch, segment) for touch in smoothing.touches]
    kept = replace(
        smoothing, touches=tuple(touch for touch in touches if touch.first <= touch.last), **each
    )
    return replace(piece, **parts, smoothing=(kept,))


def _cut(touch: Touch, segment: Segment) -> Touch:
    low, high, shift = segment.kept.start, segment.kept.stop - 1, segment.first
    first, last = touch.first + shift, touch.last + shift
    inside = [
        (row + shift, deviation)
        for row, deviation in zip(touch.changes, touch.change_deviations, strict=True)
        if low <= row + shift <= high
    ]
    begin = dict.fromkeys(("start", "start_deviation", "start_limit")) if first < low else {}
    close = dict.fromkeys(("end", "end_deviation", "end_limit")) if last > high else {}
    return replace(
        touch,
        first=max(first, low),
        last=min(last, high),
        changes=tuple(row for row, _ in inside),
        change_deviations=tuple(deviation for _, deviation in inside),
        jumps=tuple(row + shift for row in touch.jumps if low <= row + shift <= high),
        **begin,
        **close,
    )


def _joined(parts: list[Smoothing]) -> Smoothing:
    touches: list[Touch] = []
    for touch in (touch for part in parts for touch in part.touches):
        before = touches[-1] if touches else touch
        if before.last == touch.first - 1 and before.end is None and touch.start is None:
            touches[-1] = replace(
                touch,
                first=before.first,
                start=before.start,
                start_deviation=before.start_deviation,
                start_limit=before.start_limit,
                changes=before.changes + touch.changes,
                jumps=before.jumps + touch.jumps,
                change_deviations=before.change_deviations + touch.change_deviations,
            )
        else:
            touches.append(touch)
    return Smoothing(
        tuple(touches),
        np.median([part.intensities for part in parts], axis=0),
        np.concatenate([part.drift for part in parts]),
        np.concatenate([part.weight for part in parts]),
        np.concatenate([part.tilt for part in parts]),
        parts[0].model_error,
        float(np.sum([part.log_likelihood for part in parts])),
    )
