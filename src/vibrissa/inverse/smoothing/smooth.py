"""Smoothing's entry point: contacts of a sweep in, the same contacts smoothed along it out.

Long recordings are smoothed in segments, so that memory is bounded and time grows with the samples:
cut at rest, or overlapping within a contact.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from vibrissa.contacts import ContactKind, Status
from vibrissa.geometry.checks import not_negative
from vibrissa.inverse.checks.check import with_contradictions, with_delay
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import with_shared
from vibrissa.inverse.smoothing.breaks import with_jumps, with_snaps
from vibrissa.inverse.smoothing.changes import drawn, reversed_fit, with_onset, with_phases
from vibrissa.inverse.smoothing.estimate import by_itself, contacts_of
from vibrissa.inverse.smoothing.fit import MOST_STEPS, as_flank, averaged, first_guess, fitted
from vibrissa.inverse.smoothing.kalman import INTENSITIES, WRENCH, Gaussian
from vibrissa.inverse.smoothing.model import (
    FREE,
    GO_ON,
    JUMP,
    TARED,
    Flags,
    NoMotionError,
    incidence_spread_of,
    runs_of,
    series_of,
)
from vibrissa.inverse.smoothing.result import Smoothing, Touch

_ROUNDS = 4
"""Of looking for jumps: each finds all that are not close to others."""
_LONGEST, _OVERLAP = 16384, 2048
"""Samples: some hundred MB of states, and an overlap in whose middle a cut is not felt."""
_REST = 128
"""Samples without contact in the middle of which two segments may meet."""


def smooth(
    found: Reconstruction,
    *,
    false_alarm: float = 1e-3,
    model_error: float = 2e-4,
    progress: Callable[[int, int], None] | None = None,
) -> Reconstruction:
    """Contacts smoothed along their sweep: each uses all samples of it, the noise of the wrench is
    known, and a contact moves evenly until it changes.

    Parameters
    ----------
    found
        Contacts of one sweep (n, …) or of several (m, n, …), with the covariance of their
        reactions. Where its `friction` is 0, tangential contacts are square to their force; where
        it is not known (None), or greater, their incidence is free.
    false_alarm
        Share of samples without contact that may be taken for contact.
    model_error
        Standard deviation in rod lengths, on each axis, of what statics of an ideal rod leaves out.
        It is added to the covariances.
    progress
        Called with the samples done and all of them, now and then, in long recordings.

    Returns
    -------
    Reconstruction
        The same rows. `point`, `normal`, `arc_length`, `energy` and `modulus` given all samples,
        their covariances, and `smoothing`: starts and ends of contacts, changes of phase, jumps,
        outliers, drift.

    Raises
    ------
    ValueError
        If the noise is not known, `false_alarm` is not between 0 and 1, or `model_error` is
        negative.

    Notes
    -----
    A fixed-interval smoother on the manifold of single contacts (mechanics.md, "Smoothing along a
    sweep"). Nothing is smoothed across starts and ends of contacts and jumps; at changes between
    tip and tangential contact the point is continuous and its motion is not. Where the signal does
    not tell in which phase a contact is, points and covariances are those of the mixture. Rows that
    the model does not explain keep or get a status, and rows that it cannot smooth keep the contact
    of the sample by itself, AMBIGUOUS. Recordings of more than 16384 samples are smoothed in
    segments: time grows with the samples, memory hardly.
    """
    if not 0 < false_alarm < 1:
        raise ValueError(f"false_alarm = {false_alarm!r}; allowed is a number between 0 and 1")
    model_error = not_negative(model_error, "model_error")
    if found.reactions.covariance is None:
        raise ValueError(
            "found.reactions.covariance = None: smoothing needs the noise of the wrench; "
            "give the sensor force_noise and torque_noise"
        )
    alone = found.kind.ndim == 1
    each = [_smoothed(trail, false_alarm, model_error, progress) for trail in found.trails]
    rows: dict[str, Any] = {name: np.stack([part[name] for part, _ in each]) for name in each[0][0]}
    if alone:
        rows = {name: value[0] for name, value in rows.items()}
    smoothing: Any = tuple(told for _, told in each)
    smoothed = with_shared(replace(found, **rows, smoothing=smoothing))
    smoothed = with_delay(smoothed) if alone else smoothed
    # What the check of the setup says of these errors, beside what smoothing found.
    told, ours = with_contradictions(smoothed), smoothed.status == Status.SETUP_CONTRADICTED
    status = np.where(ours, Status.SETUP_CONTRADICTED, told.status).astype(np.int8)
    return replace(told, status=status)


def _smoothed(
    found: Reconstruction,
    false_alarm: float,
    model_error: float,
    progress: Callable[[int, int], None] | None,
) -> tuple[dict[str, Any], Smoothing]:
    """Contacts of one trail, segment by segment, and what is said beside them."""
    segments, zero = _segments_of(found.kind == ContactKind.NONE), TARED
    pieces, intensities, likelihood = [], [], 0.0
    for segment, after in zip(segments, [*segments[1:], segments[-1][1:]], strict=True):
        first, stop, kept, cut = segment
        part, row = found[first:stop], min(after[0], stop - 1) - first
        try:
            piece, zero, intensity, told = _smoothed_segment(
                part, zero, row, false_alarm, model_error
            )
        except (NoMotionError, np.linalg.LinAlgError):
            count = stop - first
            piece = by_itself(part) | {
                "drift": np.zeros((count, WRENCH)),
                "weight": np.ones(count),
                "tilt": np.full(count, np.nan),
                "labels": np.zeros((count, 2), dtype=int),
                "marks": np.full((count, 7), np.nan),
            }
            intensity, told = np.zeros(INTENSITIES), -np.inf
        if found.reactions.time is None:
            piece["marks"][:, [0, 3]] += first
        # Copied, so that the rows of the overlap are freed.
        pieces.append(
            {name: value[kept - first : cut - first].copy() for name, value in piece.items()}
        )
        intensities.append(intensity)
        likelihood += told
        if progress is not None and len(segments) > 1:
            progress(cut, len(found.kind))
    rows: dict[str, Any] = {
        name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]
    }
    return rows, Smoothing(
        _touches(rows.pop("labels"), rows.pop("marks")),
        np.median(intensities, axis=0),
        rows.pop("drift"),
        rows.pop("weight"),
        rows.pop("tilt"),
        model_error,
        likelihood,
    )


def _segments_of(resting: Flags) -> list[tuple[int, int, int, int]]:
    """First row of each segment and that after its last; the same of the rows that are kept."""
    count, low, kept, segments = len(resting), 0, 0, []
    while count - low > _LONGEST:
        high, middle = low + _LONGEST, low + _LONGEST // 2
        stop, cut, following = high, high - _OVERLAP // 2, high - _OVERLAP
        rests = [run for run in runs_of(resting[middle:high]) if run[1] - run[0] >= _REST]
        if rests:
            longest = max(rests, key=lambda run: (run[1] - run[0], run[0]))
            stop = cut = following = middle + sum(longest) // 2
        segments.append((low, stop, kept, cut))
        low, kept = following, cut
    return [*segments, (low, count, kept, count)]


def _smoothed_segment(
    found: Reconstruction, zero: Gaussian, row: int, false_alarm: float, model_error: float
) -> tuple[dict[str, Any], Gaussian, np.ndarray, float]:
    """One series: phases guessed, motion fitted, jumps and phases found in it, starts and ends
    placed, the rest judged. Also the zero at `row`, given the samples before, the intensities and
    the log-likelihood.
    """
    series = series_of(found.rod, found.reactions, found.status == Status.RINGING)
    series = series._replace(sound=series.sound & (found.status != Status.TOUCHES_TWICE))
    spread = incidence_spread_of(found.friction, found.reactions.setup_errors)
    fit = fitted(first_guess(series, zero, false_alarm, spread), local=False)
    # Once more, now that the drift of the zero is known.
    guess = first_guess(series, fit.states.zero, false_alarm, spread)
    fit = fit._replace(labels=guess.labels, linear=guess.linear)
    fit = fitted(fit._replace(labels=with_snaps(fit)))
    # What is tangential is no jump.
    phased, places = with_phases(fit)
    if not np.array_equal(phased.labels.phase, fit.labels.phase):
        fit = fitted(phased)
    jumped = False
    for _ in range(_ROUNDS):
        labels = with_jumps(fit)
        if np.array_equal(labels.link, fit.labels.link):
            break
        fit, jumped = fitted(fit._replace(labels=labels)), True
    if jumped:
        fit, places = with_phases(fit)
    # Time, deviation and limit of starts and of ends; deviations of changes of phase [s].
    marks, after = np.full((len(series.time), 7), np.nan), len(series.time) - 1
    marks[:, 6] = series.step
    for change, place in places.items():
        marks[change, 6] *= place.deviation
    for first, last in runs_of(fit.labels.phase != FREE):
        # The end is looked for after the beginning is placed, so that they cannot pass each other.
        if first > 0:
            fit, begin, told = with_onset(fit, first)
            marks[begin, :3] = told
        if last < after:
            back, begin, told = with_onset(reversed_fit(fit), after - last)
            fit = fit._replace(labels=reversed_fit(back).labels)
            marks[after - begin, 3:6] = series.time[-1] - told[0], *told[1:]
    smoothest = fit = fitted(fit, most_steps=MOST_STEPS)
    if (fit.labels.phase != FREE).any():
        flank = as_flank(fit)
        fit = averaged(flank, drawn(flank, places))
    rows = contacts_of(found, fit, smoothest, model_error)
    rows |= {"labels": np.stack(fit.labels[:2], axis=1), "marks": marks}
    zero = Gaussian(*(part[row] for part in smoothest.states.expected_zero))
    return rows, zero, fit.intensities, float(np.sum(fit.states.log_likelihood))


def _touches(labels: np.ndarray, marks: np.ndarray) -> tuple[Touch, ...]:
    phase, link = labels.T
    begins = np.diff(phase, prepend=FREE) != 0
    broken = (link == JUMP) | (link > GO_ON) & ~begins
    touches = []
    for first, last in runs_of(phase != FREE):
        edges = np.stack([marks[first, :3], marks[last, 3:6]], axis=1).ravel().tolist()
        inside = slice(first + 1, last + 1)
        changes, jumps = (first + 1 + np.flatnonzero(part[inside]) for part in (begins, broken))
        told = (tuple(part.tolist()) for part in (changes, jumps, marks[changes, 6]))
        each: list[Any] = [None if np.isnan(edge) else edge for edge in edges]
        touches.append(Touch(first, last, *(each + [*told])))
    return tuple(touches)
