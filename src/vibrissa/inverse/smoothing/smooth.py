"""Smoothing's entry point: contacts of a sweep in, the same contacts smoothed along it out."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind, Status
from vibrissa.geometry.checks import not_negative
from vibrissa.inverse.checks.check import with_contradictions, with_delay
from vibrissa.inverse.result import Reconstruction, trail_of
from vibrissa.inverse.shared import sensitivities, with_shared
from vibrissa.inverse.smoothing.changes import (
    Model,
    Places,
    jumps,
    with_fewer_phases,
    with_placed_changes,
    with_snaps,
    with_tangential_phases,
)
from vibrissa.inverse.smoothing.fit import (
    MOST_STEPS,
    Fit,
    Zero,
    as_flank,
    averaged,
    first_guess,
    first_weights,
    fitted,
    initial_states,
    rates_of,
)
from vibrissa.inverse.smoothing.kalman import WRENCH
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, COORDINATES, TILT
from vibrissa.inverse.smoothing.phases import detected, runs_of
from vibrissa.inverse.smoothing.result import Smoothing, Touch
from vibrissa.inverse.smoothing.rivals import drawn
from vibrissa.inverse.smoothing.segments import ROWS, Piece, in_segments
from vibrissa.inverse.smoothing.series import (
    FREE,
    GO_ON,
    JUMP,
    Labels,
    NoMotionError,
    Series,
    linearised,
    modulus_spread_of,
    quieted,
    series_of,
    steps_of,
)
from vibrissa.inverse.smoothing.shared import smoothed_sensitivity
from vibrissa.inverse.smoothing.touch import (
    Onset,
    onset_at,
    onset_of,
    reversed_labels,
    reversed_model,
)
from vibrissa.inverse.smoothing.verdict import Verdict, judged, without
from vibrissa.reactions import turned_covariance

_ROUNDS = 4
_START = np.array([1.0, 1.0, 0.01, 1e-6, 1e-3])


def smooth(
    found: Reconstruction,
    *,
    false_alarm: float = 1e-3,
    model_error: float = 2e-4,
    progress: Callable[[int, int], None] | None = None,
) -> Reconstruction:
    """Contacts smoothed along their sweep: all samples tell of each point, the noise of the wrench
    is known, and a contact moves evenly until it changes.

    Parameters
    ----------
    found
        Contacts of one sweep (n, …) or of several (m, n, …), with the covariance of their
        reactions. Where its `friction` is 0, k² = ½ is used in tangential contact.
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
            "found.reactions.covariance = None: smoothing needs the noise of the wrench; give the sensor force_noise and torque_noise"
        )
    if found.kind.ndim == 1:
        return _contradicted(with_delay(_smoothed_trail(found, false_alarm, model_error, progress)))
    parts = [
        _smoothed_trail(trail_of(found, j), false_alarm, model_error, progress)
        for j in range(len(found.kind))
    ]
    stacked: dict[str, Any] = {
        name: np.stack([getattr(part, name) for part in parts])
        for name in ROWS
        if getattr(parts[0], name) is not None
    }
    return _contradicted(
        replace(
            found, **stacked, smoothing=tuple(part.smoothing[0] for part in parts if part.smoothing)
        )
    )


def _contradicted(smoothed: Reconstruction) -> Reconstruction:
    """With what the check of the setup says of these errors, beside what smoothing found."""
    told = with_contradictions(smoothed)
    ours = smoothed.status == Status.SETUP_CONTRADICTED
    return replace(
        told, status=np.where(ours, Status.SETUP_CONTRADICTED, told.status).astype(np.int8)
    )


def _smoothed_trail(
    found: Reconstruction,
    false_alarm: float,
    model_error: float,
    progress: Callable[[int, int], None] | None,
) -> Reconstruction:
    def run(part: Reconstruction, zero: Zero, row: int) -> Piece:
        try:
            return _smoothed_segment(part, zero, row, false_alarm, model_error)
        except (NoMotionError, np.linalg.LinAlgError):
            return Piece(_by_samples(part, model_error), zero)

    return in_segments(found, run, progress)


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
    status = np.where(
        found.in_contact & (found.status == Status.OK), Status.AMBIGUOUS, found.status
    ).astype(np.int8)
    return replace(found, status=status, smoothing=(none,))


def _smoothed_segment(
    found: Reconstruction, zero: Zero, row: int, false_alarm: float, model_error: float
) -> Piece:
    ringing = found.status == Status.RINGING
    series = quieted(series_of(found.rod, found.reactions), ringing)
    series = series._replace(sound=series.sound & (found.status != Status.TOUCHES_TWICE))
    modulus_spread = modulus_spread_of(found.friction, found.reactions.setup_errors)
    count = len(series.time)
    drift, spread = np.tile(zero.mean, (count, 1)), np.tile(zero.covariance, (count, 1, 1))
    loaded = detected(series, drift, spread, false_alarm) & ~ringing
    labels, about = first_guess(series, loaded, drift)
    rates = rates_of(series, labels, about)
    fit = fitted(
        series,
        Fit(labels, about, first_weights(series), _START, initial_states(count), zero),
        rates,
        modulus_spread=modulus_spread,
        local=False,
    )
    # Once more, now that the drift of the zero is known.
    drift, spread = (
        fit.states.mean[:, 2 * COORDINATES :],
        fit.states.covariance[:, 2 * COORDINATES :, 2 * COORDINATES :],
    )
    loaded = detected(series, drift, spread, false_alarm) & ~ringing
    labels, about = first_guess(series, loaded, drift)
    labels = with_snaps(series, labels)
    fit = fitted(
        series, fit._replace(labels=labels, about=about), rates, modulus_spread=modulus_spread
    )
    # What is tangential is no jump.
    labels, places = _phased(_model(series, fit, rates, modulus_spread=modulus_spread), fit.labels)
    if not np.array_equal(labels.phase, fit.labels.phase):
        fit = fitted(series, fit._replace(labels=labels), rates, modulus_spread=modulus_spread)
    jumped = False
    for _ in range(_ROUNDS):
        broken = jumps(_model(series, fit, rates, modulus_spread=modulus_spread), fit.labels)
        if not broken:
            break
        jumped = True
        link = fit.labels.link.copy()
        for at, kind in broken:
            link[at] = kind
        fit = fitted(
            series,
            fit._replace(labels=fit.labels._replace(link=link)),
            rates,
            modulus_spread=modulus_spread,
        )
    if jumped:
        labels, places = _phased(
            _model(series, fit, rates, modulus_spread=modulus_spread), fit.labels
        )
        fit = fit._replace(labels=labels)
    labels, touches = _bounded(series, fit, places, rates, ringing, modulus_spread=modulus_spread)
    smoothest = fit = fitted(
        series,
        fit._replace(labels=labels),
        rates,
        modulus_spread=modulus_spread,
        most_steps=MOST_STEPS,
    )
    if touches:
        flank = as_flank(series, fit, rates, modulus_spread=modulus_spread)
        candidates = drawn(
            _model(series, flank, rates, modulus_spread=modulus_spread), flank.labels, places
        )
        fit = averaged(series, flank, candidates, rates, modulus_spread=modulus_spread)
    told = smoothest.states
    following = Zero(
        told.expected[row, 2 * COORDINATES :],
        told.uncertainty[row, 2 * COORDINATES :, 2 * COORDINATES :],
    )
    return Piece(
        _result(
            found,
            series,
            fit,
            rates,
            judged(found, series, smoothest, linearised(smoothest.about)),
            touches,
            model_error,
        ),
        following,
    )


def _model(
    series: Series, fit: Fit, rates: Float[np.ndarray, "5"], *, modulus_spread: float | None
) -> Model:
    return Model(series, fit.about, fit.weight, rates, fit.intensities, fit.states, modulus_spread)


def _bounded(
    series: Series,
    fit: Fit,
    places: dict[int, Places],
    rates: Float[np.ndarray, "5"],
    ringing: Bool[np.ndarray, "n"],
    *,
    modulus_spread: float | None,
) -> tuple[Labels, tuple[Touch, ...]]:
    """Labels with the contacts' beginnings and ends where they are most probable, and the contacts."""
    model, labels = _model(series, fit, rates, modulus_spread=modulus_spread), fit.labels
    # The end is looked for after the beginning is placed, so that they cannot pass each other.
    deviations = {change: place.deviation for change, place in places.items()}
    backwards, count = reversed_model(model), len(series.time)
    touches = []
    for first, last in list(runs_of(labels.phase != FREE)):
        start = onset_of(model, labels, first) if first > 0 else None
        labels = labels if start is None else onset_at(labels, first, start.place)
        end = (
            onset_of(backwards, reversed_labels(labels), count - 1 - last)
            if last < count - 1
            else None
        )
        if end is not None:
            end = _before(end, series, np.flatnonzero(ringing[last + 1 :])[:1] + last + 1)
            labels = reversed_labels(onset_at(reversed_labels(labels), count - 1 - last, end.place))
        touches.append(_touch(series, labels, start, end, (first, last), deviations))
    return labels, tuple(touches)


def _before(end: Onset, series: Series, swinging: Int[np.ndarray, "k"]) -> Onset:
    """An end, seen backwards, no later than the rod begins to swing."""
    earliest = len(series.time) - 0.5 - swinging
    if not swinging.size or end.place >= earliest[0]:
        return end
    middle = (series.time[swinging[0]] + series.time[swinging[0] - 1]) / 2
    return end._replace(place=float(earliest[0]), time=float(series.time[-1] - middle))


def _phased(model: Model, labels: Labels) -> tuple[Labels, dict[int, Places]]:
    return with_placed_changes(
        model, with_tangential_phases(model, with_fewer_phases(model, labels))
    )


def _touch(
    series: Series,
    labels: Labels,
    start: Onset | None,
    end: Onset | None,
    rough: tuple[int, int],
    deviations: dict[int, float],
) -> Touch:
    count = len(series.time)
    first = rough[0] if start is None else int(np.floor(start.place)) + 1
    last = rough[1] if end is None else count - 2 - int(np.floor(end.place))
    inside = np.arange(first + 1, last + 1)
    changes = inside[labels.phase[inside] != labels.phase[inside - 1]]
    step = series.step
    broken = np.setdiff1d(inside[labels.link[inside] > GO_ON], changes)
    return Touch(
        first,
        last,
        None if start is None else start.time,
        None if end is None else float(series.time[-1]) - end.time,
        None if start is None else start.deviation,
        None if end is None else end.deviation,
        None if start is None else start.limit,
        None if end is None else end.limit,
        tuple(map(int, changes)),
        tuple(map(int, np.union1d(broken, inside[labels.link[inside] == JUMP]))),
        tuple(step * deviations.get(int(change), 1.0) for change in changes),
    )


def _result(
    found: Reconstruction,
    series: Series,
    fit: Fit,
    rates: Float[np.ndarray, "5"],
    verdict: Verdict,
    touches: tuple[Touch, ...],
    model_error: float,
) -> Reconstruction:
    length, units = found.rod.length, np.repeat([found.rod.force_scale, found.rod.moment_scale], 3)
    phase, about = fit.labels.phase, fit.about
    touching = (phase != FREE) & series.sound
    linear = linearised(about)
    values, jacobian = linear
    errors = fit.states.covariance[:, :COORDINATES, :COORDINATES]
    point = found.reactions.trail.position + length * np.einsum(
        "nij,nj->ni", series.turn, values.reach
    )
    normal = np.einsum("nij,nj->ni", series.turn, values.direction)
    steps = steps_of(
        series,
        fit.labels,
        about,
        fit.weight,
        rates,
        modulus_spread=modulus_spread_of(found.friction, found.reactions.setup_errors),
        linear=linear,
    )
    sensitivity = smoothed_sensitivity(
        found.rod, found.reactions, series, fit.labels, steps, linear, fit.intensities
    )
    numbers = np.concatenate(
        [part.reshape(len(point), -1) for part in (point, jacobian, errors, sensitivity)], axis=1
    )
    verdict = without(verdict, found, touching & ~np.isfinite(numbers).all(axis=1) & ~verdict.raw)
    # Errors of the robot's pose are not taken to be others in each sample: they stay in full.
    floor, turned = np.eye(3) * (model_error * length) ** 2, np.zeros((3, 3))
    by_pose = found.reactions.pose_covariance(point)
    if by_pose is not None:
        floor = floor + by_pose
    if found.reactions.rotation_covariance is not None:
        turned = turned_covariance(found.reactions.rotation_covariance, normal)
    of_point = series.turn @ jacobian[:, WRENCH + 1 :]
    of_normal = series.turn @ linear.of_direction
    unwhitened = np.einsum(
        "nij,nj->ni", np.linalg.inv(series.whitening), fit.states.mean[:, 2 * COORDINATES :]
    )
    tilt = np.where(touching, about[:, TILT], np.nan)
    smoothing = Smoothing(
        touches,
        fit.intensities,
        unwhitened * units,
        np.where(series.sound, fit.weight, 1.0),
        tilt,
        model_error,
        float(np.sum(fit.states.log_likelihood)),
    )

    def rows(values: np.ndarray, raw: np.ndarray | None, nothing: float = np.nan) -> np.ndarray:
        assert raw is not None
        given = np.where(_column(touching, values), values, nothing)
        return np.where(_column(verdict.raw, values), raw, given)

    smoothed = replace(
        found,
        sensitivity=rows(sensitivity, sensitivities(found) if verdict.raw.any() else sensitivity),
        kind=rows(phase, found.kind, ContactKind.NONE).astype(np.int8),
        point=rows(point, found.point),
        force_direction=rows(normal, found.force_direction),
        arc_length=rows(length * about[:, ARC_LENGTH], found.arc_length),
        energy=rows(found.rod.moment_scale * values.energy, found.energy, 0.0),
        modulus=rows(values.modulus, found.modulus),
        covariance=rows(
            length**2 * of_point @ errors @ np.swapaxes(of_point, 1, 2) + floor,
            found.covariance_noise,
        ),
        normal_covariance=rows(
            of_normal @ errors @ np.swapaxes(of_normal, 1, 2) + turned,
            found.normal_covariance_noise,
        ),
        arc_length_deviation=rows(
            length * np.sqrt(np.maximum(errors[:, ARC_LENGTH, ARC_LENGTH], 0.0)),
            found.arc_length_deviation,
        ),
        status=verdict.status,
        smoothing=(smoothing,),
    )
    return with_shared(smoothed)


def _column(rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    return rows.reshape(-1, *[1] * (values.ndim - 1))
