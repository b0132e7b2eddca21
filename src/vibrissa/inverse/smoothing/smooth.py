"""Smoothing's entry point: contacts of a sweep in, the same contacts smoothed along it out.

Long recordings are smoothed in segments, cut at rest or overlapping within a contact, so that
memory is bounded and time grows with the samples.
"""

from dataclasses import replace
from typing import Any

import jax
import numpy as np

from vibrissa.contacts import ContactKind, Status
from vibrissa.geometry.checks import not_negative, share
from vibrissa.inverse.checks.check import with_contradictions, with_delay
from vibrissa.inverse.parameters import prepared
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import with_shared
from vibrissa.inverse.smoothing.branches import branch_of
from vibrissa.inverse.smoothing.changes import (
    Places,
    beyond_tip,
    drawn,
    reversed_fit,
    with_onset,
    with_phases,
    within_the_rod,
)
from vibrissa.inverse.smoothing.estimate import by_itself, contacts_of
from vibrissa.inverse.smoothing.fit import (
    MOST_STEPS,
    as_flank,
    averaged,
    first_guess,
    fitted,
    led_astray,
    mistrusted,
)
from vibrissa.inverse.smoothing.kalman import INTENSITIES, WRENCH, Gaussian
from vibrissa.inverse.smoothing.manifold import smoothed_model
from vibrissa.inverse.smoothing.model import (
    FREE,
    GO_ON,
    JUMP,
    TARED,
    Fit,
    Flags,
    Labels,
    NoMotionError,
    Samples,
    incidence_spread_of,
    series_of,
)
from vibrissa.inverse.smoothing.phases import changes_near_snaps, with_jumps
from vibrissa.inverse.smoothing.result import Smoothing, Touch
from vibrissa.numerics.progress import Progress, Stages, Tally
from vibrissa.numerics.runs import runs

_ROUNDS = 4
"""Of looking for jumps, each of which finds all that are not close to others; and for contacts
beyond the tip.
"""
_LONGEST, _OVERLAP = 16384, 2048
"""Samples: some hundred MB of states, and enough overlap for a cut in its middle not to show."""
_STAGES = 6
"""Of a segment: two fits to first guesses, phases, jumps, starts and ends, the result."""
_REST = 128
"""Samples without contact in whose middle two segments may meet."""


def smooth(
    found: Reconstruction,
    *,
    false_alarm: float = 1e-3,
    model_error: float = 2e-4,
    progress: Progress | None = None,
) -> Reconstruction:
    """Contacts smoothed along their sweep: each uses all samples of it, given the noise of
    the wrench, and assumes that a contact moves smoothly until it changes.

    Parameters
    ----------
    found
        Contacts of one sweep (n, …) or several (m, n, …), with the covariance of their reactions.
        If their `friction` is 0, tangential contacts are perpendicular to their force; if it is
        unknown (None), or greater, their incidence is free.
    false_alarm
        Fraction of samples without contact that may be mistaken for contact.
    model_error
        Standard deviation in rod lengths, on each axis, of what the statics of an ideal rod leave
        out. It is added to the covariances.
    progress
        `progress(done, total)` is called now and then with the samples done and their total, a
        sixth of them after each of the six stages that all samples of a segment go through.

    Returns
    -------
    Reconstruction
        The same rows: `point`, `normal`, `arc_length`, `energy` and `modulus` given all samples,
        their covariances, and `smoothing`: starts and ends of contacts, changes of phase, jumps,
        outliers, drift.

    Raises
    ------
    ValueError
        If the noise is unknown, `false_alarm` is not between 0 and 1, or `model_error` is negative.

    Notes
    -----
    A fixed-interval smoother on the manifold of single contacts (mechanics.md, "Smoothing along a
    sweep"). Nothing is smoothed across starts and ends of contacts, or across jumps; at changes
    between tip and tangential contact the point is continuous and its motion is not. Where the
    signal does not tell which phase a contact is in, points and covariances are those of the
    mixture. Rows that the model does not explain keep or get a status, and rows that it cannot
    smooth keep the contact of the single sample, AMBIGUOUS. Recordings of more than 16384 samples
    are smoothed in segments: time grows with the samples, memory hardly.
    """
    share(false_alarm, "false_alarm")
    model_error = not_negative(model_error, "model_error")
    if found.reactions.covariance is None:
        raise ValueError(
            "found.reactions.covariance = None: smoothing needs the noise of the wrench; "
            "give the sensor force_noise and torque_noise"
        )
    alone, tally = found.kind.ndim == 1, Tally(progress, found.kind.size)
    parts, told = zip(
        *(_smoothed(trail, false_alarm, model_error, tally) for trail in found.trails),
        strict=True,
    )
    rows: dict[str, Any] = jax.tree.map(lambda *of: of[0] if alone else np.stack(of), *parts)
    errors = prepared(found.rod, found.reactions.setup_errors).covariance
    smoothed = replace(found, **with_shared(rows, found.rod.length, errors), smoothing=told)
    smoothed = with_delay(smoothed) if alone else smoothed
    # What the setup check says in terms of these errors, plus what smoothing found.
    checked, ours = with_contradictions(smoothed), smoothed.status == Status.SETUP_CONTRADICTED
    status = np.where(ours, Status.SETUP_CONTRADICTED, checked.status).astype(np.int8)
    return replace(checked, status=status)


def _smoothed(
    found: Reconstruction,
    false_alarm: float,
    model_error: float,
    tally: Tally,
) -> tuple[dict[str, Any], Smoothing]:
    """Contacts of one trail, segment by segment, and what is reported besides."""
    count, zero, likelihood = len(found.kind), TARED, 0.0
    branch = branch_of(found)
    status = np.where(branch.sure, Status.OK, found.status).astype(np.int8)
    found = replace(found, status=status)
    time = np.arange(count, dtype=float) if found.reactions.time is None else found.reactions.time
    segments, pieces, intensities = _segments_of(found.kind == ContactKind.NONE), [], []
    for number, (segment, kept) in enumerate(segments):
        stages = Stages(tally, kept.stop - kept.start, _STAGES)
        try:
            piece, fit = _smoothed_segment(
                found[segment],
                time[segment],
                branch.arc_length[segment],
                zero,
                false_alarm,
                model_error,
                stages,
            )
        except (NoMotionError, np.linalg.LinAlgError):
            size = segment.stop - segment.start
            piece = by_itself(found[segment]) | {
                "drift": np.zeros((size, WRENCH)),
                "weight": np.ones(size),
                "tilt": np.full(size, np.nan),
                "labels": Labels.of(np.full(size, FREE)),
                "edges": np.full((size, 2, 3), np.nan),
                "change_deviation": np.full(size, np.nan),
            }
            intensities.append(np.zeros(INTENSITIES))
            likelihood = -np.inf
        else:
            intensities.append(fit.intensities)
            likelihood += float(np.sum(fit.states.log_likelihood))
            if number + 1 < len(segments):
                after = min(segments[number + 1][0].start, segment.stop - 1) - segment.start
                zero = fit.rows(slice(after, None)).zero
        inside = slice(kept.start - segment.start, kept.stop - segment.start)
        # Copied, so that the rows of the overlap are freed.
        pieces.append(jax.tree.map(lambda part, inside=inside: part[inside].copy(), piece))
        stages.end()
    rows = jax.tree.map(lambda *parts: np.concatenate(parts), *pieces)
    touches = _touches(*map(rows.pop, ("labels", "edges", "change_deviation")))
    drift, weight, tilt = map(rows.pop, ("drift", "weight", "tilt"))
    intensity = np.median(intensities, axis=0)
    open_ = (found.status == Status.NOT_UNIQUE) & (rows["status"] == Status.OK)
    rows["status"] = np.where(open_, Status.NOT_UNIQUE, rows["status"])
    return rows, Smoothing(
        touches, intensity, drift, weight, tilt, model_error, likelihood, branch.probability
    )


def _segments_of(resting: Flags) -> list[tuple[slice, slice]]:
    """Rows of each segment, and which of them are kept."""
    count, low, kept, segments = len(resting), 0, 0, []
    while count - low > _LONGEST:
        high, middle = low + _LONGEST, low + _LONGEST // 2
        stop, cut, following = high, high - _OVERLAP // 2, high - _OVERLAP
        rests = ((last - first, first) for first, last in runs(resting[middle:high]))
        size, start = max(rests, default=(0, 0))
        if size > _REST:
            stop = cut = following = middle + start + (size - 1) // 2
        segments.append((slice(low, stop), slice(kept, cut)))
        low, kept = following, cut
    return [*segments, (slice(low, count), slice(kept, count))]


def _smoothed_segment(
    found: Reconstruction,
    time: Samples,
    near: Samples,
    zero: Gaussian,
    false_alarm: float,
    model_error: float,
    stages: Stages,
) -> tuple[dict[str, Any], Fit]:
    """One series: guess phases, fit the motion, find jumps and phases in it, place starts and ends,
    judge the rest.
    """
    rod = smoothed_model(found.rod)
    series = series_of(found, time, rod, near)
    spread = incidence_spread_of(found.friction, found.reactions.setup_errors)
    first = first_guess(rod, series, zero, false_alarm, spread)
    fit = fitted(first, local=False)
    stages.end_one()
    starts = [first]
    if not led_astray(fit, first):
        # Again, now that the drift of the zero is known.
        guess = first_guess(rod, series, fit.states.zero, false_alarm, spread)
        again = fit._replace(labels=guess.labels, linear=guess.linear)
        starts = [again, first] if mistrusted(fit) else [again]
    fits = [_within_the_rod(_at_snaps(start)) for start in starts]
    stages.end_one()
    # So that tangential contact is not taken for a jump.
    phased = [_in_phases(fit) for fit in fits]
    stages.end_one()
    broken = [_with_breaks(*of) for of in phased]
    fit, places = max(broken, key=lambda of: np.sum(of[0].states.log_likelihood))
    stages.end_one()
    # Time, deviation and limit of starts and of ends; deviations of phase changes [s].
    edges = np.full((len(time), 2, 3), np.nan)
    change_deviation = np.full(len(time), series.step)
    for change, place in places.items():
        change_deviation[change] *= place.deviation
    for rows in fit.labels.contacts:
        # The end is sought once the beginning is placed, so that they cannot pass each other.
        if rows.start > 0:
            fit, begin, told = with_onset(fit, rows.start)
            edges[begin, 0] = told
        if rows.stop < len(time):
            back, begin, told = with_onset(reversed_fit(fit), len(time) - rows.stop)
            fit = fit._replace(labels=reversed_fit(back).labels)
            edges[-1 - begin, 1] = time[-1] - told[0], *told[1:]
    stages.end_one()
    smoothest = fit = fitted(fit, most_steps=MOST_STEPS)
    if fit.labels.touching.any():
        flank = as_flank(fit)
        fit = averaged(flank, drawn(flank, places))
    return contacts_of(found, fit, smoothest, model_error) | {
        "labels": fit.labels,
        "edges": edges,
        "change_deviation": change_deviation,
    }, fit


def _in_phases(fit: Fit) -> tuple[Fit, dict[int, Places]]:
    """Fitted with its phases, and where else each change may be."""
    phased, places = with_phases(fit)
    if not np.array_equal(phased.labels.phase, fit.labels.phase):
        fit = _within_the_rod(fitted(phased))
    return fit, places


def _with_breaks(fit: Fit, places: dict[int, Places]) -> tuple[Fit, dict[int, Places]]:
    """Fitted with breaks of its motion, and the phases then."""
    jumped = False
    for _ in range(_ROUNDS):
        labels = with_jumps(fit)
        if np.array_equal(labels.link, fit.labels.link):
            break
        fit, jumped = fitted(fit._replace(labels=labels)), True
    if jumped:
        fit, places = with_phases(fit)
        fit = _within_the_rod(fit)
    return fit, places


def _at_snaps(fit: Fit) -> Fit:
    """Fitted; a change of phase near a jump is moved onto it if the fit is then more likely."""
    fit = fitted(fit)
    for change, jump in changes_near_snaps(fit.labels):
        labels = fit.labels.moved(change, jump)
        labels.link[jump] = JUMP
        moved = fitted(fit._replace(labels=labels))
        if np.sum(moved.states.log_likelihood) > np.sum(fit.states.log_likelihood):
            fit = moved
    return fit


def _within_the_rod(fit: Fit) -> Fit:
    """Fitted again until no contact lies beyond the tip; as it was where that has another cause."""
    tried = fit
    for _ in range(_ROUNDS):
        labels = within_the_rod(tried.labels, tried.states)
        if np.array_equal(labels.phase, tried.labels.phase):
            break
        tried = fitted(tried._replace(labels=labels))
    return fit if beyond_tip(tried.labels, tried.states).any() else tried


def _touches(labels: Labels, edges: np.ndarray, deviation: Samples) -> tuple[Touch, ...]:
    broken = (labels.link == JUMP) | (labels.link > GO_ON) & ~labels.begins
    touches = []
    for rows in labels.contacts:
        first, last = rows.start, rows.stop - 1
        after = np.arange(first + 1, rows.stop)
        changes, jumps = (after[part[after]] for part in (labels.begins, broken))
        places = np.stack([edges[first, 0], edges[last, 1]], axis=1).ravel().tolist()
        told: list[Any] = [None if np.isnan(place) else place for place in places]
        told += [tuple(part.tolist()) for part in (changes, jumps, deviation[changes])]
        touches.append(Touch(first, last, *told))
    return tuple(touches)
