"""The entry point: from recordings over a known object to a calibrated setup."""

import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.calibration.arrays import Square, Vectors, Wrenches
from vibrissa.calibration.bench import Bench, SetupType, bench_of
from vibrissa.calibration.equilibrium import Pose, State, free_readings
from vibrissa.calibration.fit import check_equilibria, disturbed, fitted, unevenness
from vibrissa.calibration.form import REST, form_of
from vibrissa.calibration.held_out import first_contacts, held_out
from vibrissa.calibration.parameters import (
    Parameter,
    checked_prior,
    default_names,
    parameters,
    uncertain,
)
from vibrissa.calibration.problem import WRENCH, Linear, Point, Problem, by_rows
from vibrissa.calibration.result import Calibration, Residuals, concluded
from vibrissa.calibration.rows import CalibrationError, gathered, sweeps_of
from vibrissa.calibration.score import scores
from vibrissa.calibration.statistics import covariance, fitness, undetermined
from vibrissa.calibration.suspects import held as unsure
from vibrissa.calibration.suspects import object_size
from vibrissa.calibration.unknown_object import calibrated_without_object
from vibrissa.calibration.verdict import moved, warnings_of
from vibrissa.contacts import RecordingWarning
from vibrissa.geometry.checks import not_negative
from vibrissa.inverse import reconstruct
from vibrissa.numerics.progress import Guess, Progress
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor import RawRecording
from vibrissa.surfaces import Mesh, Offset, Surface
from vibrissa.surfaces.base import Placed
from vibrissa.tolerances import Tolerances
from vibrissa.trail import Trail

_USUAL_STEPS = 40
"""Linearisations, 7 to 40 in the recordings of the tests, and score tests."""
_WORST_SPREAD = 8.0
"""Median residual, relative to noise, beyond which no fit explains the data."""
_MOST_ROUNDS = 10
"""Rounds of leaving rows out and sizing the unevenness; they settle in two to five."""
_ALIKE = 0.1
"""Relative change of the unevenness that is not worth another fit: less than a grid step."""
_GOOD_SPREAD = 1.1
"""Median residual, relative to noise, from which other starts are tried."""
_OTHER_LENGTHS = (-0.06, 0.06)
"""ln of the ratio of rod length to the stated one: twice what that may be off by."""
_ROLL = "clamp_orientation_z"
_EXACT, _UNKNOWN = 1e-9, 1.0
"""Bounds of the prior deviations, in the parameters' scales: beyond them a parameter is held, or
free, to every digit of its estimate.
"""
_STEEPEST = 0.3
"""Share of a force along the normal below which its direction says nothing about friction."""


def calibrate(
    recordings: "Reactions | RawRecording | Sequence[Reactions | RawRecording]",
    setup: SetupType,
    surface: Surface | None = None,
    free: Iterable[str] | None = None,
    *,
    prior: Mapping[str, float] | None = None,
    friction: float = 0.0,
    tolerances: Tolerances | None = None,
    progress: Progress | None = None,
) -> Calibration[SetupType]:
    """Calibrate rod, mount, sensor and object pose from sweeps over a known object, by least
    squares on the six reactions.

    Parameters
    ----------
    recordings
        One or more sweeps, each with a stretch at rest and free of contact: reactions as
        `read_recording` returns them with this setup, or raw recordings as `Sensor.measure` does.
    setup
        Rod and sensor to start from; for a 50 mm rod they may be off by up to about 20 % in
        stiffness, 3 % in length, 2 mm and 3°.
    surface
        The object; by default that of the setup. Without either, the calibration finds what tip and
        tangential contacts with an unknown object determine: each obeys more conditions than it has
        unknowns. Parameters they leave open are held, and named in `identifiability`; tare errors
        are allowed for, not estimated.
    free
        What to calibrate: `youngs_modulus` (for rods with a radius) or `bending_stiffness`,
        `length`, `clamp_position`, `clamp_orientation`, `object_position`, `object_orientation`,
        `standoff`, `gain` (each channel) or `force_gain` and `torque_gain`, `tare` and `drift`; of
        the rod's form `taper` (by which fraction the radius falls to the tip) or `tip_radius`,
        `rest_curvature` (the same all along) with `rest_roll` (towards which side), and
        `support_stiffness` (of a pivot, about each of the clamp's axes).
        What is not named is held, or bounded by its tolerance. By default the stiffness, `length`,
        `clamp_position`, `clamp_orientation`, `tare` and `drift`. The tare of each recording is
        always fitted, as its error would otherwise be missing from those of the other parameters.
    prior
        Prior standard deviations of free parameters, by name and in their units (Pa, N m², m, rad,
        1).
    friction
        Coulomb friction coefficient between rod and object; 0 for none. With friction each sample's
        tangential force is unknown, and only contact points and rod carry information.
    tolerances
        Standard deviations of the values stated for setup and object; by default those of the
        setup. What has one and is not named in `free` is fitted too, with its tolerance as a prior,
        so that estimates, covariance and setup allow for it; `object_scale` as a `standoff`. A
        delay is not fitted but enters the covariance. What is named in `free` is not held back by
        its tolerance. An estimate that moves by more than three tolerances gives a warning.
    progress
        `progress(done, total)` is called after each step of the fit; the total is a guess, which
        grows if more steps are needed.

    Returns
    -------
    Calibration
        Setup, estimates with confidence intervals, identifiability, residuals. Estimates are those
        of the rod as warm as it is in the setup.

    Raises
    ------
    ValueError
        If an argument is unknown or out of range; the text says which and what is allowed.
    CalibrationError
        If the recordings have no contact, no rest, or too few samples, or if rod and object as
        given cannot explain them.

    Warns
    -----
    RecordingWarning
        For each of `Calibration.warnings`: estimates far from their given values, rows left out,
        readings better explained by another size or place of the object, a gain, friction, a delay,
        or a taper or curvature of the rod (score tests on all rows), and parts of the data that the
        others do not predict.

    Notes
    -----
    Residuals are readings minus those of the contact equilibrium at each pose, weighted by the
    covariance of wrench and pose, including noise of the robot's orientation.
    Their derivatives are exact (implicit function theorem).
    Parameters that the data leave open are held as given and named in `identifiability`. Where the
    residuals are more than noise, variances are inflated (`fitness.inflation`): by the residuals'
    mean square and, where they are correlated in time, by their long-run variance.

    Stretches that no equilibrium explains, such as where the rod swings, or sticks and slips, are
    left out (`fitness.disturbed`). The gap at which the rod touches the object as given varies
    along each sweep and is estimated with the rest, with the size that makes the data most likely
    (`Calibration.unevenness`; restricted maximum likelihood, H. D. Patterson, R. Thompson,
    Biometrika 58 (1971) 545-554).
    """
    surface = setup.surface if surface is None else surface
    names = default_names(setup.rod) if free is None else tuple(free)
    chosen = parameters(names, setup.rod)
    deviations = checked_prior(prior, names)
    listed = [recordings] if isinstance(recordings, Reactions | RawRecording) else list(recordings)
    known = getattr(setup, "tolerances", None) if tolerances is None else tolerances
    coefficient = not_negative(friction, "friction")
    sensor = setup.sensor.carrying(setup.rod)
    sweeps = sweeps_of(listed, sensor)
    steps = Guess(progress, _USUAL_STEPS)
    if surface is None:
        result = calibrated_without_object(
            sweeps, setup, names, chosen, deviations, coefficient, known or Tolerances(), steps
        )
    else:
        start = bench_of(setup.rod, setup.sensor, form_of(setup.rod, names))
        given = start.numbers(setup.sensor)
        rows = gathered(sweeps, sensor)
        priors = [deviations.get(one.group, math.inf) / abs(one.slope(given)) for one in chosen]
        problem = Problem(
            surface, rows, start, chosen, np.array(priors), "drift" in names, coefficient,
            np.zeros(len(rows.time), dtype=bool), steps=steps,
        )  # fmt: skip
        try:
            result = _calibrated(problem, setup, names, known)
        except np.linalg.LinAlgError as error:
            raise CalibrationError(
                f"the equations of the fit cannot be solved ({error}): friction = {coefficient:g} "
                "and the standard deviations in `prior` have to be physically plausible"
            ) from error
    steps.end()
    for line in result.warnings:
        warnings.warn(line, RecordingWarning, stacklevel=2)
    return result


def _calibrated(
    problem: Problem, setup: SetupType, names: tuple[str, ...], known: Tolerances | None
) -> Calibration[SetupType]:
    """Fit; hold what the solution shows to be open, and continue without it."""
    allowed, rod = known or Tolerances(), setup.rod
    offsets = _first_offsets(problem)
    states = _states(problem, problem.start, offsets[:, None], rod)
    pivot = _pivot(problem.surface, np.asarray(states.point))
    problem = replace(problem, start=problem.start._replace(pivot=pivot))
    size = abs(object_size(problem.surface, problem.start, states.point))
    within = uncertain(rod, allowed)
    if allowed.object_scale > 0:
        within |= dict.fromkeys(parameters(["standoff"], rod), allowed.object_scale * size)
    # What is not free is bounded by its tolerance; what is free is not.
    fields = {one.field for one in problem.free}
    more = {one: deviation for one, deviation in within.items() if one.field not in fields}
    problem = replace(problem, free=[*problem.free, *more])
    spreads, scales = np.append(problem.prior, list(more.values())), problem.scales
    problem = replace(problem, prior=np.clip(spreads, _EXACT * scales, _UNKNOWN * scales))
    chosen, held = problem.free, dict[str, tuple[str, ...]]()
    linear = _best(problem, states, rod, offsets)
    while True:
        # What is open before refinement stays open: refining it first would be wasted.
        opened = undetermined(linear)
        if not opened:
            linear = _refined(linear)
            opened = undetermined(linear)
        if not opened:
            _check_explained(linear)
            groups = tuple(dict.fromkeys([*names, *(one.group for one in chosen)]))
            return _result(setup, groups, chosen, held, linear, known, within)
        held |= opened
        if len(opened) == len(linear.problem.free):
            raise CalibrationError(
                f"these recordings determine none of the free parameters: {', '.join(held)}"
            )
        linear = fitted(*linear.without(opened))


def _refined(linear: Linear) -> Linear:
    """Fit again without stretches that do not fit, and with the unevenness that the data show,
    until neither changes.
    """
    for count in range(_MOST_ROUNDS):
        problem, size = linear.problem, unevenness(linear)
        rows = disturbed(linear) if count else problem.disturbed
        if np.array_equal(rows, problem.disturbed) and math.isclose(
            size, problem.unevenness, rel_tol=_ALIKE
        ):
            break
        linear = fitted(replace(problem, disturbed=rows, unevenness=size), linear.point)
    return linear


def _best(problem: Problem, states: State, rod: Rod, offsets: Wrenches) -> Linear:
    """Fit from the start; if that leaves more than noise, also from a shorter and a longer rod:
    tangential contact does not show the rod's length.
    """
    values = np.zeros(len(problem.known))
    problem.offsets(values)[:, 0] = offsets
    found = _seeded_anew(fitted(problem, Point(values, states)), rod)
    length = [index for index, one in enumerate(problem.free) if one.group == "length"]
    if not length or found.spread < _GOOD_SPREAD:
        return found
    for change in _OTHER_LENGTHS:
        values[length] = change
        try:
            again = _seeded_anew(fitted(problem, Point(values.copy(), states)), rod)
        except CalibrationError:
            continue
        found = max(found, again, key=_rows_that_fit)
    return found


def _rows_that_fit(linear: Linear) -> float:
    return float(np.sum(linear.weights(1.0)))


def _seeded_anew(linear: Linear, rod: Rod) -> Linear:
    """If some rows do not fit, fit again from states computed with the parameters found: rows may
    be caught on another equilibrium. Keep the fit that suits more rows.
    """
    problem, values = linear.problem, linear.point.values
    if np.all(linear.weights(linear.spread)[problem.rows.contact] == 1):
        return linear
    states = _states(problem, linear.bench, problem.offsets(values), rod)
    return max(linear, fitted(problem, Point(values, states)), key=_rows_that_fit)


def _check_explained(linear: Linear) -> None:
    if linear.spread > _WORST_SPREAD:
        raise CalibrationError(
            "rod and object as given do not explain the recordings: residuals are "
            f"{linear.spread:.0f} times the noise in the median, allowed are {_WORST_SPREAD:g}: "
            "check the object's shape and pose, friction, the sign of the wrench, and what is free"
        )
    check_equilibria(linear)


def _first_offsets(problem: Problem) -> Wrenches:
    """Offsets of recordings whose tare was taken at rest: what loads along the rod do there."""
    rows, bench = problem.rows, problem.start
    offsets = np.zeros((rows.recordings, WRENCH))
    if bench.loaded:
        for recording in range(rows.recordings):
            rest = np.flatnonzero(~rows.contact & (rows.recording == recording))
            pose = jax.tree.map(lambda part: part[rest], rows.pose)  # noqa: B023
            free = free_readings((bench, np.ones(1)), pose)
            offsets[recording] = np.mean(rows.wrench[rest] - free.wrench, axis=0)
    return offsets


def _states(
    problem: Problem, bench: Bench, offsets: Float[np.ndarray, "recordings trends 6"], rod: Rod
) -> State:
    """From the reconstruction of each row, its point moved to the nearest one on the object."""
    rows, contact = problem.rows, problem.rows.contact
    axes = rows.pose.axes[contact]
    trends = problem.trends[:, : offsets.shape[1]]
    zero = np.einsum("nt,nti->ni", trends, offsets[rows.recording])
    wrench = ((rows.wrench - zero) / bench.gain)[contact]
    moment = wrench[:, 3:] - np.cross(bench.clamp - bench.wrench_point, wrench[:, :3])
    force, moment = (by_rows(axes, part) for part in (wrench[:, :3], moment))
    trail = Trail(
        rows.pose.position[contact] + axes @ bench.clamp, Rotation.from_matrix(axes @ bench.axes)
    )
    found = reconstruct(bench.rod(rod), Reactions(trail, force, moment), check=False).point
    tip = trail.position + bench.length * trail.axis
    surface = bench.placed(problem.surface)
    points = surface.nearest(np.where(np.isfinite(found).all(axis=1)[:, None], found, tip))
    magnitude = np.linalg.norm(force, axis=1)
    normal, direction = surface.normal(points), -force / magnitude[:, None]
    along = np.sum(direction * normal, axis=1, keepdims=True)
    leaning = (direction - along * normal) / np.maximum(along, _STEEPEST)
    load = None
    if bench.loaded:
        # From the resultants of the free rod's loads.
        pose = Pose(rows.pose.position[contact], axes)
        load = -free_readings((bench, np.ones(1)), pose).reactions
        resultant = -(force + load[:, :3])
        magnitude = np.linalg.norm(resultant, axis=1)
        direction = resultant / magnitude[:, None]
    return State(points, magnitude, leaning if problem.friction > 0 else 0 * leaning, load)


def _pivot(surface: Surface, points: Vectors) -> Float[np.ndarray, "3"]:
    """The object's centre if it has one; else the middle of the contact points."""
    if isinstance(surface, Placed):
        turn, move = np.asarray(surface.rotation), np.asarray(surface.translation)
        return move + turn @ _pivot(surface.surface, (points - move) @ turn)
    if isinstance(surface, Mesh):
        return np.mean(surface.vertices, axis=0)
    if isinstance(surface, Offset):
        return _pivot(surface.surface, points)
    center = getattr(surface, "center", None)
    return np.median(points, axis=0) if center is None else np.asarray(center)


def _turned(free: list[Parameter], bench: Bench) -> Callable[[Square], Square]:
    """Turns a matrix over steps, of which two are of the rest curvature in fixed directions, into
    one over steps along and across the direction found.
    """
    names = [one.name for one in free]
    if not {*REST} <= {*names}:
        return lambda matrix: matrix
    places = [names.index(name) for name in REST]
    roll = bench.shape.polar[1] - bench.shape.roll
    turn = np.eye(len(names))
    turn[np.ix_(places, places)] = [[np.cos(roll), np.sin(roll)], [-np.sin(roll), np.cos(roll)]]
    return lambda matrix: turn @ matrix @ turn.T


def _result(
    setup: SetupType,
    names: tuple[str, ...],
    chosen: list[Parameter],
    held: dict[str, tuple[str, ...]],
    linear: Linear,
    known: Tolerances | None,
    within: dict[Parameter, float],
) -> Calibration[SetupType]:
    problem, rows, rod, allowed = (
        linear.problem,
        linear.problem.rows,
        setup.rod,
        known or Tolerances(),
    )
    weight, count = linear.weights(linear.spread), len(problem.free)
    found = fitness(linear, weight)
    errors = covariance(linear, weight, found.inflation, unsure(linear, rod, allowed))
    bench = linear.bench.unrolled(setup.sensor) if _ROLL in held else linear.bench
    numbers = bench.numbers(setup.sensor)
    turned = _turned(problem.free, bench)
    information = linear.information(linear.weights(1.0))[:count, :count]
    estimates, own, identified = concluded(
        setup, chosen, problem.free, held, bench,
        covariance=turned(np.ascontiguousarray(errors[:count, :count])),
        alone=1 / np.sqrt(np.diag(turned(information))),
        slopes=np.array([one.slope(numbers) for one in problem.free]),
    )  # fmt: skip
    # A drift that was not free is zero, with no error.
    offsets, spreads = np.zeros((2, rows.recordings, 2, WRENCH))
    trends = problem.trends.shape[1]
    offsets[:, :trends] = problem.offsets(linear.point.values)
    spreads[:, :trends] = problem.offsets(np.sqrt(np.diag(errors)))
    posed = {"object_position", "object_orientation"} & set(names)
    surface = bench.placed(problem.surface) if posed else problem.surface
    excess = float(found.inflation.max())
    parts = held_out(linear, weight, excess)
    missed = first_contacts(surface, linear)
    causes = scores(linear, rod, allowed, excess)
    moves = moved(chosen, estimates, rod, within)
    return Calibration(
        setup=bench.setup(setup, surface),
        surface=surface,
        estimates=estimates,
        covariance=own,
        identifiability=identified,
        residuals=Residuals(
            rows.recording,
            rows.seconds,
            rows.contact,
            rows.wrench,
            linear.predicted,
            linear.whitened,
            weight,
            linear.chi_square,
        ),
        fitness=found,
        tare=offsets[:, 0],
        tare_deviation=spreads[:, 0],
        drift=offsets[:, 1],
        drift_deviation=spreads[:, 1],
        pivot=np.asarray(bench.pivot),
        pose=(np.asarray(bench.turn), np.asarray(bench.move)),
        friction=problem.friction,
        unevenness=problem.unevenness,
        free=names,
        warnings=warnings_of(
            linear, rod, estimates.get("length"), moves, found, causes, parts, missed
        ),
        held_out=parts,
        first_contact=missed,
        tolerances=known,
    )
