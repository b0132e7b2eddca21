"""Long recordings are smoothed in segments, so that memory is bounded and time grows with the
samples: cut at rest, or overlapping within a contact.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool

from vibrissa.contacts import ContactKind
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.smoothing.fit import Zero
from vibrissa.inverse.smoothing.phases import runs_of
from vibrissa.inverse.smoothing.result import Smoothing, Touch
from vibrissa.trail import Trail

_LONGEST, _OVERLAP = 16384, 2048
_REST = 128
"""Samples without contact in the middle of which two segments may meet."""
ROWS = (
    "kind",
    "point",
    "force_direction",
    "arc_length",
    "energy",
    "modulus",
    "covariance",
    "normal_covariance",
    "covariance_noise",
    "normal_covariance_noise",
    "sensitivity",
    "arc_length_deviation",
    "chi_square",
    "single_contact_residual",
    "status",
)
"""Fields of a reconstruction that hold one entry a sample."""


class Segment(NamedTuple):
    """Rows smoothed together, from `first` to before `stop`, and those of them that are kept."""

    first: int
    stop: int
    kept: slice


class Piece(NamedTuple):
    """A segment, smoothed, and the sensor's zero at the row at which the next one begins."""

    found: Reconstruction
    zero: Zero


def segments_of(resting: Bool[np.ndarray, "n"]) -> list[Segment]:
    """Segments of at most 16384 rows."""
    count, low, kept, segments = len(resting), 0, 0, []
    while count - low > _LONGEST:
        high, middle = low + _LONGEST, low + _LONGEST // 2
        rests = [
            (last - first, middle + (first + last) // 2)
            for first, last in runs_of(resting[middle:high])
            if last - first >= _REST
        ]
        at_rest = max(rests)[1] if rests else None
        stop, cut, following = (
            (at_rest,) * 3 if at_rest is not None else (high, high - _OVERLAP // 2, high - _OVERLAP)
        )
        segments.append(Segment(low, stop, slice(kept, cut)))
        low, kept = following, cut
    return [*segments, Segment(low, count, slice(kept, count))]


def in_segments(
    found: Reconstruction,
    run: Callable[[Reconstruction, Zero, int], Piece],
    progress: Callable[[int, int], None] | None = None,
) -> Reconstruction:
    """Smooth one trail; `run` is given a segment, the zero at its beginning, and the row of it at
    which the next one begins.
    """
    segments, zero = segments_of(found.kind == ContactKind.NONE), Zero.tared()
    pieces, count = [], len(found.kind)
    for k, segment in enumerate(segments):
        following = segments[k + 1].first if k + 1 < len(segments) else segment.stop
        piece, zero = run(
            part_of(found, segment), zero, min(following, segment.stop - 1) - segment.first
        )
        if len(segments) == 1:
            return piece
        pieces.append(_kept(piece, segment))
        if progress is not None:
            progress(segment.kept.stop, count)
    return _joined(found, segments, pieces)


def part_of(found: Reconstruction, segment: Segment) -> Reconstruction:
    """The rows of a segment."""
    if segment.first == 0 and segment.stop == len(found.kind):
        return found
    given, rows = found.reactions, slice(segment.first, segment.stop)
    assert given.covariance is not None
    reactions = replace(
        given,
        trail=Trail(given.trail.position[rows], given.trail.orientation[rows]),
        force=given.force[rows],
        moment=given.moment[rows],
        time=np.arange(segment.first, segment.stop, dtype=float)
        if given.time is None
        else given.time[rows],
        covariance=given.covariance if given.covariance.ndim == 2 else given.covariance[rows],
        rotation_center=None if given.rotation_center is None else given.rotation_center[rows],
        velocity=None if given.velocity is None else given.velocity[rows],
    )
    parts: dict[str, Any] = {
        name: getattr(found, name)[rows] for name in ROWS if getattr(found, name) is not None
    }
    return replace(found, reactions=reactions, **parts)


def _kept(piece: Reconstruction, segment: Segment) -> Reconstruction:
    """Only the rows that are kept, copied, so that those of the overlap are freed; contacts with
    rows of the whole recording.
    """
    rows = slice(segment.kept.start - segment.first, segment.kept.stop - segment.first)
    parts: dict[str, Any] = {
        name: getattr(piece, name)[rows].copy() for name in ROWS if getattr(piece, name) is not None
    }
    assert piece.smoothing is not None
    smoothing = piece.smoothing[0]
    touches = [_cut(touch, segment) for touch in smoothing.touches]
    kept = replace(
        smoothing,
        touches=tuple(touch for touch in touches if touch.first <= touch.last),
        drift=smoothing.drift[rows].copy(),
        weight=smoothing.weight[rows].copy(),
        tilt=smoothing.tilt[rows].copy(),
    )
    return replace(piece, **parts, smoothing=(kept,))


def _cut(touch: Touch, segment: Segment) -> Touch:
    first, last = touch.first + segment.first, touch.last + segment.first
    low, high = segment.kept.start, segment.kept.stop - 1
    inside = [k for k, row in enumerate(touch.changes) if low <= row + segment.first <= high]
    begin = dict.fromkeys(("start", "start_deviation", "start_limit")) if first < low else {}
    close = dict.fromkeys(("end", "end_deviation", "end_limit")) if last > high else {}
    return replace(
        touch,
        first=max(first, low),
        last=min(last, high),
        changes=tuple(touch.changes[k] + segment.first for k in inside),
        change_deviations=tuple(touch.change_deviations[k] for k in inside),
        jumps=tuple(
            row + segment.first for row in touch.jumps if low <= row + segment.first <= high
        ),
        **begin,
        **close,
    )


def _joined(
    found: Reconstruction, segments: list[Segment], pieces: list[Reconstruction]
) -> Reconstruction:
    parts = [piece.smoothing[0] for piece in pieces if piece.smoothing]
    touches: list[Touch] = []
    for part, segment in zip(parts, segments, strict=True):
        for touch in part.touches:
            goes_on = (
                touches
                and touches[-1].last == segment.kept.start - 1
                and touch.first == segment.kept.start
            )
            if goes_on and touches[-1].end is None and touch.start is None:
                touches[-1] = _both(touches[-1], touch)
            else:
                touches.append(touch)
    smoothing = Smoothing(
        tuple(touches),
        np.median([part.intensities for part in parts], axis=0),
        np.concatenate([part.drift for part in parts]),
        np.concatenate([part.weight for part in parts]),
        np.concatenate([part.tilt for part in parts]),
        parts[0].model_error,
        float(np.sum([part.log_likelihood for part in parts])),
    )
    rows: dict[str, Any] = {
        name: np.concatenate([getattr(piece, name) for piece in pieces])
        for name in ROWS
        if getattr(pieces[0], name) is not None
    }
    return replace(found, **rows, smoothing=(smoothing,))


def _both(one: Touch, other: Touch) -> Touch:
    """One contact of two that follow each other."""
    summed = {
        name: getattr(one, name) + getattr(other, name)
        for name in ("changes", "jumps", "change_deviations")
    }
    return replace(
        one,
        last=other.last,
        end=other.end,
        end_deviation=other.end_deviation,
        end_limit=other.end_limit,
        **summed,
    )
