"""Smoothing's entry point: contacts of a sweep in, the same contacts smoothed along it out."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from vibrissa.contacts import Status
from vibrissa.geometry.checks import not_negative
from vibrissa.inverse.checks.check import with_contradictions, with_delay
from vibrissa.inverse.result import Reconstruction, trail_of
from vibrissa.inverse.smoothing.breaks import with_jumps, with_snaps
from vibrissa.inverse.smoothing.changes import Places, with_phases
from vibrissa.inverse.smoothing.estimate import contacts_of
from vibrissa.inverse.smoothing.fit import MOST_STEPS, as_flank, averaged, first_guess, fitted
from vibrissa.inverse.smoothing.kalman import WRENCH, Gaussian
from vibrissa.inverse.smoothing.manifold import COORDINATES
from vibrissa.inverse.smoothing.model import incidence_spread_of
from vibrissa.inverse.smoothing.phases import detected, runs_of
from vibrissa.inverse.smoothing.result import Smoothing, Touch
from vibrissa.inverse.smoothing.rivals import drawn
from vibrissa.inverse.smoothing.segments import Piece, in_segments, rows_of
from vibrissa.inverse.smoothing.series import (
    FREE,
    GO_ON,
    JUMP,
    Fit,
    Flags,
    NoMotionError,
    series_of,
)
from vibrissa.inverse.smoothing.touch import Onset, onset_at, onset_of, reversed_fit
from vibrissa.inverse.smoothing.verdict import by_itself, judged

_ROUNDS = 4
"""Of looking for jumps: each finds all that are not close to others."""


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

    def run(part: Reconstruction, zero: Gaussian, row: int) -> Piece:
        try:
            return _smoothed_segment(part, zero, row, false_alarm, model_error)
        except (NoMotionError, np.linalg.LinAlgError):
            return Piece(_by_samples(part, model_error), zero)

    if found.kind.ndim == 1:
        smoothed = with_delay(in_segments(found, run, progress))
    else:
        parts = [in_segments(trail_of(found, j), run, progress) for j in range(len(found.kind))]
        stacked: dict[str, Any] = {
            name: np.stack([getattr(part, name) for part in parts]) for name in rows_of(parts[0])
        }
        smoothing = tuple(part.smoothing[0] for part in parts if part.smoothing)
        smoothed = replace(found, **stacked, smoothing=smoothing)
    # What the check of the setup says of these errors, beside what smoothing found.
    told, ours = with_contradictions(smoothed), smoothed.status == Status.SETUP_CONTRADICTED
    status = np.where(ours, Status.SETUP_CONTRADICTED, told.status).astype(np.int8)
    return replace(told, status=status)


def _by_samples(found: Reconstruction, model_error: float) -> Reconstruction:
    """Contacts of the samples by themselves, where smoothing finds no motion that explains them."""
    count = len(found.kind)
    none = Smoothing(
        (),
        np.zeros(COORDINATES),
        np.zeros((count, WRENCH)),
        np.ones(count),
        np.full(count, np.nan),
        model_error,
        -np.inf,
    )
    status = np.where(found.in_contact, by_itself(found), found.status).astype(np.int8)
    return replace(found, status=status, smoothing=(none,))


def _smoothed_segment(
    found: Reconstruction, zero: Gaussian, row: int, false_alarm: float, model_error: float
) -> Piece:
    """One series: phases guessed, motion fitted, jumps and phases found in it, starts and ends
    placed, the rest judged.
    """
    ringing = found.status == Status.RINGING
    series = series_of(found.rod, found.reactions, ringing)
    series = series._replace(sound=series.sound & (found.status != Status.TOUCHES_TWICE))
    guess = first_guess(series, detected(series, zero, false_alarm) & ~ringing, zero.mean)
    spread = incidence_spread_of(found.friction, found.reactions.setup_errors)
    fit = fitted(guess._replace(zero=zero, incidence_spread=spread), local=False)
    # Once more, now that the drift of the zero is known.
    drift = fit.states.zero
    guess = first_guess(series, detected(series, drift, false_alarm) & ~ringing, drift.mean)
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
    fit, touches = _bounded(fit, places, ringing)
    smoothest = fit = fitted(fit, most_steps=MOST_STEPS)
    if touches:
        flank = as_flank(fit)
        fit = averaged(flank, drawn(flank, places))
    smoothed = contacts_of(found, fit, judged(found, smoothest), touches, model_error)
    following = smoothest.states.expected_zero
    return Piece(smoothed, Gaussian(following.mean[row], following.covariance[row]))


def _bounded(fit: Fit, places: dict[int, Places], ringing: Flags) -> tuple[Fit, tuple[Touch, ...]]:
    """The fit with its contacts' beginnings and ends where they are most probable; the contacts."""
    after, touches = len(ringing) - 1, []
    for first, last in list(runs_of(fit.labels.phase != FREE)):
        # The end is looked for after the beginning is placed, so that they cannot pass each other.
        begins, start, ends, end = first, None, last, None
        if first > 0:
            start = onset_of(fit, first)
            fit = fit._replace(labels=onset_at(fit.labels, first, start.place))
            begins = int(np.floor(start.place)) + 1
        if last < after:
            back = reversed_fit(fit)
            end = _before(onset_of(back, after - last), fit, last, ringing)
            back = back._replace(labels=onset_at(back.labels, after - last, end.place))
            fit = fit._replace(labels=reversed_fit(back).labels)
            ends = after - 1 - int(np.floor(end.place))
        touches.append(_touch(fit, places, (begins, start), (ends, end)))
    return fit, tuple(touches)


def _before(end: Onset, fit: Fit, last: int, ringing: Flags) -> Onset:
    """An end, seen backwards, no later than the rod begins to swing."""
    time, swinging = fit.series.time, last + 1 + np.flatnonzero(ringing[last + 1 :])
    if not swinging.size or end.place >= len(time) - 0.5 - swinging[0]:
        return end
    middle = (time[swinging[0]] + time[swinging[0] - 1]) / 2
    return end._replace(place=len(time) - 0.5 - float(swinging[0]), time=float(time[-1] - middle))


def _touch(
    fit: Fit,
    places: dict[int, Places],
    begin: tuple[int, Onset | None],
    close: tuple[int, Onset | None],
) -> Touch:
    (first, start), (last, end), labels = begin, close, fit.labels
    rows = np.arange(first + 1, last + 1)
    changes = rows[labels.begins[rows]]
    broken = rows[(labels.link[rows] == JUMP) | (labels.link[rows] > GO_ON) & ~labels.begins[rows]]
    step = fit.series.step
    return Touch(
        first,
        last,
        start and start.time,
        end and float(fit.series.time[-1]) - end.time,
        start and start.deviation,
        end and end.deviation,
        start and start.limit,
        end and end.limit,
        tuple(map(int, changes)),
        tuple(map(int, broken)),
        tuple(step * (places[row].deviation if row in places else 1.0) for row in changes),
    )
