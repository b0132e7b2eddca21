"""The entry point: from recordings over a known object to a calibrated setup."""

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.calibration.equilibrium import Bench
from vibrissa.calibration.fit import (
    WRENCH,
    Linear,
    Point,
    Problem,
    disturbed,
    fitted,
    spread,
    unevenness,
    weights,
    with_unevenness,
)
from vibrissa.calibration.held_out import first_contacts, held_out
from vibrissa.calibration.parameters import (
    DEFAULT_FREE,
    STIFFNESS,
    Parameter,
    checked_prior,
    parameters,
)
from vibrissa.calibration.result import Calibration, Estimate, Residuals, SetupLike, SetupType
from vibrissa.calibration.rows import CalibrationError, gathered
from vibrissa.calibration.score import scores
from vibrissa.calibration.statistics import (
    considered,
    covariance,
    fitness,
    identifiability,
    undetermined,
)
from vibrissa.calibration.suspects import held as unsure
from vibrissa.calibration.suspects import object_size, uncertain
from vibrissa.calibration.unknown_object import calibrated_without_object
from vibrissa.calibration.verdict import warnings_of
from vibrissa.contacts import RecordingWarning
from vibrissa.geometry.checks import not_negative
from vibrissa.geometry.rotation import rotation_matrices, turning_axis_to
from vibrissa.inverse import reconstruct
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor import RawRecording, Sensor
from vibrissa.surfaces import Mesh, Offset, Surface
from vibrissa.surfaces.base import Placed
from vibrissa.tolerances import Tolerances
from vibrissa.trail import Trail

_WORST_SPREAD = 8.0
_LEAST_SHARE = 0.5
_MOST_ROUNDS = 5
_ALIKE = 0.1
_GOOD_SPREAD = 1.1
_OTHER_LENGTHS = (-0.06, 0.06)
_ROLL = "clamp_orientation_z"
_SPREADS = (1e-9, 1e9)
_DRIFT = 1.0
"""Standard deviation of a free drift over a recording before the data, in those of one sample."""


def calibrate(
    recordings: "Reactions | RawRecording | Sequence[Reactions | RawRecording]",
    setup: SetupType,
    surface: Surface | None = None,
    free: Iterable[str] | None = None,
    *,
    prior: Mapping[str, float] | None = None,
    friction: float = 0.0,
    tolerances: Tolerances | None = None,
) -> Calibration[SetupType]:
    """Rod, mount, sensor and object's pose from sweeps over a known object: least squares on the
    six reactions.

    Parameters
    ----------
    recordings
        One or more sweeps, each with a rest free of contact: reactions as `read_recording` gives
        them with this setup, or raw as `Sensor.measure` does.
    setup
        Rod and sensor to start from: off by up to about 20 % in stiffness, 3 % in length, 2 mm and
        3° of a 50 mm rod.
    surface
        The object; by default that of the setup. Without either, what tip and tangential contacts
        with an unknown object determine: each obeys more conditions than it has unknowns.
        Parameters that they leave open are held, and named in `identifiability`; errors of the
        tares are allowed for, not estimated.
    free
        What to calibrate: `youngs_modulus` (for rods with a radius) or `bending_stiffness`,
        `length`, `clamp_position`, `clamp_orientation`, `object_position`, `object_orientation`,
        `standoff`, `gain` (each channel) or `force_gain` and `torque_gain`, `tare` and `drift`.
        What is not named is held, or bounded by its tolerance. By default the stiffness, `length`,
        `clamp_position`, `clamp_orientation`, `tare` and `drift`. The tare of each recording is
        always fitted, as otherwise its error would be missing in the others'.
    prior
        Standard deviations of free parameters, by name and in their units (Pa, N m², m, rad, 1), as
        known before.
    friction
        Coulomb's coefficient between rod and object: 0 for none. With friction each sample's
        tangential force is unknown, and only points and rod tell.
    tolerances
        Standard deviations of what the setup and the object state; by default those of the setup.
        What has one and is not named in `free` is fitted, too, bounded by its tolerance as by a
        prior, so that estimates, covariance and setup allow for it; `object_scale` as a `standoff`.
        A delay is not fitted and enters the covariance. What is named in `free` is not pulled by
        its tolerance. An estimate that moved by more than three tolerances is a warning.

    Returns
    -------
    Calibration
        Setup, estimates with confidence intervals, identifiability, residuals.

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
        For each of `Calibration.warnings`: estimates far from where they were given, rows left out,
        readings that another size or place of the object, gain, friction, delay, taper or curvature
        of the rod explain better (score tests on all rows), parts that the others do not predict.

    Notes
    -----
    Residuals are readings less those of the contact equilibrium at each pose, weighted by the
    covariance of wrench and pose. Their derivatives are exact (implicit function theorem).
    Parameters that the data leave open are held as given and named in `identifiability`. Where the
    residuals are more than noise, variances are taken larger (`fitness.inflation`): by their mean
    square, and where they are correlated in time by their long-run variance.

    Stretches that no equilibrium explains, as where the rod swings, or sticks and slips, are left
    out (`fitness.disturbed`). How far off the object as given the rod touches, changing along each
    sweep, is estimated with the rest, as large as makes the data most likely
    (`Calibration.unevenness`; restricted maximum likelihood, H. D. Patterson, R. Thompson,
    Biometrika 58 (1971) 545-554).
    """
    surface = setup.surface if surface is None else surface
    names = tuple(free) if free is not None else _default(setup.rod)
    chosen = parameters(names, setup.rod)
    deviations = checked_prior(prior, names)
    listed = [recordings] if isinstance(recordings, Reactions | RawRecording) else list(recordings)
    known = getattr(setup, "tolerances", None) if tolerances is None else tolerances
    coefficient = not_negative(friction, "friction")
    if surface is None:
        return _said(
            calibrated_without_object(
                listed, setup, names, chosen, deviations, coefficient, known or Tolerances()
            )
        )
    rows = gathered(listed, setup.sensor)
    factors = _factors(chosen, setup.rod, setup.sensor)
    spreads = (
        np.array([deviations.get(parameter.group, math.inf) for parameter in chosen]) / factors
    )
    problem = Problem(
        surface,
        rows,
        chosen,
        spreads,
        _DRIFT if "drift" in names else 0.0,
        coefficient,
        np.zeros(len(rows.time), dtype=bool),
    )
    try:
        start = _start(problem, setup.rod, setup.sensor)
        problem = _loosened(problem, start, setup.rod, known or Tolerances())
        names = (
            *names,
            *dict.fromkeys(
                parameter.group for parameter in problem.free if parameter.group not in names
            ),
        )
        fitted, held, linear = _solved(problem, start, setup.rod)
        result = _result(setup, names, problem.free, fitted, held, linear, known)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            f"the equations of the fit cannot be solved ({error}): friction = {coefficient:g} and the standard deviations of `prior` have to be of the size "
            "that they can have"
        ) from error
    return _said(result)


def _said(result: Calibration[SetupType]) -> Calibration[SetupType]:
    for line in result.warnings:
        warnings.warn(line, RecordingWarning, stacklevel=3)
    return result


def _loosened(problem: Problem, start: Point, rod: Rod, tolerances: Tolerances) -> Problem:
    """With all that has a tolerance and is not free yet, which then bounds it; what has been free
    is so without bounds.
    """
    groups = {parameter.group for parameter in problem.free}
    taken = (
        groups
        | ({"gain"} if groups & {"force_gain", "torque_gain"} else set())
        | (set(STIFFNESS) if groups & set(STIFFNESS) else set())
    )
    more = [pair for pair in uncertain(rod, tolerances) if pair[0].group not in taken]
    if tolerances.object_scale > 0 and "standoff" not in groups:
        more += [
            (one, tolerances.object_scale * abs(object_size(problem.surface, start)))
            for one in parameters(["standoff"], rod)
        ]
    free = [*problem.free, *(parameter for parameter, _ in more)]
    scales = np.array([parameter.scale for parameter in free])
    # Beyond these bounds a parameter is held, or free, to all digits.
    spreads = np.clip(
        np.append(problem.prior, [deviation for _, deviation in more]), *np.outer(_SPREADS, scales)
    )
    return replace(problem, free=free, prior=spreads)


def _stated(
    problem: Problem, point: Point, rod: Rod, sensor: Sensor, tolerances: Tolerances
) -> dict[str, float]:
    """Tolerances of estimates, by name and in their units."""
    pairs = uncertain(rod, tolerances)
    factors = _factors([parameter for parameter, _ in pairs], rod, sensor)
    found = {
        parameter.name: float(factor) * deviation
        for (parameter, deviation), factor in zip(pairs, factors, strict=True)
    }
    if tolerances.object_scale > 0:
        found["standoff"] = tolerances.object_scale * abs(object_size(problem.surface, point))
    return found


def _default(rod: Rod) -> tuple[str, ...]:
    return DEFAULT_FREE if rod.radius is not None else (STIFFNESS[1], *DEFAULT_FREE[1:])


def _factors(chosen: list[Parameter], rod: Rod, sensor: Sensor) -> Float[np.ndarray, "parameters"]:
    """Change of each estimate for a unit step of its parameter."""
    gain = np.asarray(sensor.gain)
    ties = {"force_gain": 0, "torque_gain": 3}
    factors = []
    for parameter in chosen:
        if parameter.group in STIFFNESS:
            factors.append(_stiffness(parameter.group, rod.bending_stiffness, rod))
        elif parameter.group == "length":
            factors.append(rod.length)
        elif parameter.group == "gain":
            factors.append(float(gain[int(np.argmax(parameter.direction)) - 8]))
        else:
            factors.append(float(gain[ties[parameter.group]]) if parameter.group in ties else 1.0)
    return np.array(factors)


def _stiffness(name: str, stiffness: float, rod: Rod) -> float:
    """EI, or of a round rod E = 4 EI / (π r⁴)."""
    return (
        stiffness
        if name == STIFFNESS[1] or rod.radius is None
        else stiffness / (math.pi / 4 * rod.radius**4)
    )


def _solved(
    problem: Problem, start: Point, rod: Rod
) -> tuple[Problem, dict[str, tuple[str, ...]], Linear]:
    """Fit; hold what the solution shows to be open, and fit anew without it."""
    held: dict[str, tuple[str, ...]] = {}
    while problem.free:
        problem, linear = _refined(problem, _best(problem, start, rod))
        fewer, more = undetermined(problem, linear)
        if not more:
            _check_explained(problem, linear)
            return problem, held, linear
        problem = replace(fewer, unevenness=0.0)
        held = {
            name: tuple(other for other in others if other not in more)
            for name, others in held.items()
        } | more
    raise CalibrationError(
        f"these recordings determine none of the free parameters: {', '.join(held)}"
    )


def _refined(problem: Problem, linear: Linear) -> tuple[Problem, Linear]:
    """Fit again without stretches that do not fit, and with the unevenness that the data show,
    until neither changes.
    """
    for count in range(_MOST_ROUNDS):
        size = unevenness(problem, linear)
        rows = disturbed(problem, linear) if count else problem.disturbed
        if np.array_equal(rows, problem.disturbed) and math.isclose(
            size, problem.unevenness, rel_tol=_ALIKE
        ):
            break
        problem, point = with_unevenness(replace(problem, disturbed=rows), linear.point, size)
        linear = fitted(problem, point)
    return problem, linear


def _best(problem: Problem, start: Point, rod: Rod) -> Linear:
    """Fit from the start; where that leaves more than noise, also from a shorter and a longer rod:
    one in contact along its flank does not show its length.
    """
    point = start._replace(step=np.zeros(len(problem.free)))
    found = _seeded_anew(problem, fitted(problem, point), rod)
    length = [index for index, parameter in enumerate(problem.free) if parameter.group == "length"]
    if not length or spread(problem, found) < _GOOD_SPREAD:
        return found
    for change in _OTHER_LENGTHS:
        other = point._replace(
            bench=start.bench._replace(length=start.bench.length * math.exp(change))
        )
        other.step[length[0]] = change
        try:
            found = _better(problem, found, _seeded_anew(problem, fitted(problem, other), rod))
        except CalibrationError:
            continue
    return found


def _better(problem: Problem, first: Linear, second: Linear) -> Linear:
    """The one that fits more rows."""
    return max(first, second, key=lambda one: float(np.sum(weights(problem, one, 1.0))))


def _seeded_anew(problem: Problem, linear: Linear, rod: Rod) -> Linear:
    """Where rows do not fit, fit again from states that the found parameters give: rows may be
    caught on another equilibrium. Keep what fits more rows.
    """
    if not np.any(_weights(problem, linear)[problem.rows.contact] < 1):
        return linear
    point = linear.point
    again = fitted(
        problem, point._replace(states=_states(problem, point.bench, point.offsets, rod))
    )
    return _better(problem, linear, again)


def _weights(problem: Problem, linear: Linear) -> Float[np.ndarray, "n"]:
    return weights(problem, linear, spread(problem, linear))


def _check_explained(problem: Problem, linear: Linear) -> None:
    excess = spread(problem, linear)
    if excess > _WORST_SPREAD:
        raise CalibrationError(
            f"rod and object as given do not explain the recordings: residuals are {excess:.0f} times the noise in the median, allowed are {_WORST_SPREAD:g}: "
            "check the object's shape and pose, friction, the sign of the wrench, and what is free"
        )
    share = float(np.mean(linear.readings.sound))
    if share < _LEAST_SHARE:
        raise CalibrationError(
            f"for {share:.0%} of the samples in contact the rod has an equilibrium on the object; needed are at least {_LEAST_SHARE:.0%}: "
            "check the object's shape and pose"
        )


def _start(problem: Problem, rod: Rod, sensor: Sensor) -> Point:
    bench = Bench(
        np.asarray(rod.bending_stiffness),
        np.asarray(rod.length),
        sensor.clamp_position,
        rotation_matrices(sensor.clamp_orientation),
        np.ones(WRENCH),
        np.zeros(3),
        np.eye(3),
        np.zeros(3),
        np.asarray(0.0),
    )
    offsets = np.zeros((problem.rows.recordings, 2 * WRENCH))
    states = _states(problem, bench, offsets, rod)
    bench = bench._replace(pivot=_pivot(problem.surface, states[:, :3]))
    return Point(
        bench,
        offsets,
        states,
        np.zeros(len(problem.free)),
        np.zeros((problem.rows.recordings, problem.places)),
    )


def _states(
    problem: Problem, bench: Bench, offsets: Float[np.ndarray, "recordings 12"], rod: Rod
) -> Float[np.ndarray, "contacts 7"]:
    """From the reconstruction of each row, its point taken to the nearest of the object."""
    rows = problem.rows
    pose = rows.pose[rows.contact]
    axes = pose[:, 3:12].reshape(-1, 3, 3)
    own = offsets[rows.recording]
    wrench = ((rows.wrench - own[:, :WRENCH] - rows.time[:, None] * own[:, WRENCH:]) / bench.gain)[
        rows.contact
    ]
    force, torque = wrench[:, :3], wrench[:, 3:]
    moment = torque - np.cross(bench.clamp - pose[:, 12:], force)
    force, moment = (np.einsum("nij,nj->ni", axes, part) for part in (force, moment))
    trail = Trail(pose[:, :3] + axes @ bench.clamp, Rotation.from_matrix(axes @ bench.axes))
    found = reconstruct(_rod(rod, bench), Reactions(trail, force, moment), check=False)
    tip = trail.position + float(bench.length) * trail.axis
    points = np.where(np.isfinite(found.point).all(axis=1)[:, None], found.point, tip)
    surface = _placed(problem.surface, bench)
    points = surface.nearest(points)
    magnitude = np.linalg.norm(force, axis=1, keepdims=True)
    leaning = (
        _leaning(-force / magnitude, surface.normal(points))
        if problem.rubs
        else np.zeros_like(points)
    )
    return np.concatenate([points, magnitude, leaning], axis=1)


def _leaning(
    direction: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Tangential force in units of the normal one, of forces of this direction."""
    along = np.sum(direction * normal, axis=1, keepdims=True)
    return (direction - along * normal) / np.maximum(along, 0.3)


def _pivot(surface: Surface, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """The object's centre where it has one; else the middle of where it was touched."""
    if isinstance(surface, Placed):
        turn, move = np.asarray(surface.rotation), np.asarray(surface.translation)
        return move + turn @ _pivot(surface.surface, (points - move) @ turn)
    if isinstance(surface, Mesh):
        return np.mean(surface.vertices, axis=0)
    if isinstance(surface, Offset):
        return _pivot(surface.surface, points)
    center = getattr(surface, "center", None)
    return np.median(points, axis=0) if center is None else np.asarray(center)


def _result(
    setup: SetupType,
    names: tuple[str, ...],
    chosen: list[Parameter],
    problem: Problem,
    held: dict[str, tuple[str, ...]],
    linear: Linear,
    known: Tolerances | None,
) -> Calibration[SetupType]:
    weight = _weights(problem, linear)
    found = fitness(problem, linear, weight)
    errors = covariance(problem, linear, weight, found.inflation)
    if known is not None:
        errors = errors + considered(
            problem, linear, weight, unsure(problem, linear, setup.rod, known)
        )
    count = len(problem.free)
    own = np.ascontiguousarray(errors[:count, :count])
    bench, rows = _unrolled(linear.point.bench, setup.sensor, held), problem.rows
    factors = _factors(problem.free, _rod(setup.rod, bench), _sensor(setup.sensor, bench))
    deviations = dict(
        zip(
            (parameter.name for parameter in problem.free),
            factors * np.sqrt(np.diag(own)),
            strict=True,
        )
    )
    offsets = linear.point.offsets
    offset_deviations = np.sqrt(np.diag(errors)[count : count + offsets.size]).reshape(
        offsets.shape
    )
    posed = {"object_position", "object_orientation"} & set(names)
    surface = _placed(problem.surface, bench) if posed else problem.surface
    estimates = {
        parameter.name: _estimate(parameter, setup, bench, deviations, held) for parameter in chosen
    }
    excess = float(found.inflation.max())
    parts, missed = (
        held_out(problem, linear, weight, excess),
        first_contacts(surface, problem, linear),
    )
    return Calibration(
        setup=_setup(setup, bench, surface),
        surface=surface,
        estimates=estimates,
        covariance=own * np.outer(factors, factors),
        identifiability=identifiability(problem, own, linear, held),
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
        tare=offsets[:, :WRENCH],
        tare_deviation=offset_deviations[:, :WRENCH],
        drift=offsets[:, WRENCH:],
        drift_deviation=offset_deviations[:, WRENCH:],
        pivot=np.asarray(bench.pivot),
        pose=(np.asarray(bench.turn), _move(bench)),
        friction=problem.friction,
        unevenness=problem.unevenness,
        free=names,
        warnings=warnings_of(
            estimates,
            _stated(problem, linear.point, setup.rod, setup.sensor, known or Tolerances()),
            setup.rod,
            known or Tolerances(),
            found,
            scores(problem, linear, setup.rod, excess),
            parts,
            missed,
            problem.friction,
        ),
        held_out=parts,
        first_contact=missed,
        tolerances=known,
    )


def _unrolled(bench: Bench, sensor: Sensor, held: Mapping[str, object]) -> Bench:
    """Where the roll about the rod's axis is open, the clamp's axes turned from the given ones
    without roll, the shortest way.
    """
    if _ROLL not in held:
        return bench
    given = rotation_matrices(sensor.clamp_orientation)
    return bench._replace(
        axes=given @ rotation_matrices(turning_axis_to(given.T @ np.asarray(bench.axes)[:, 2]))
    )


def _rod(rod: Rod, bench: Bench) -> Rod:
    return replace(rod, length=float(bench.length), bending_stiffness=float(bench.stiffness))


def _sensor(sensor: Sensor, bench: Bench) -> Sensor:
    turned = Rotation.from_matrix(np.asarray(bench.axes)).as_quat()
    fx, fy, fz, tx, ty, tz = (
        float(one * factor) for one, factor in zip(sensor.gain, bench.gain, strict=True)
    )
    return sensor.updated(
        clamp_position=np.asarray(bench.clamp),
        clamp_orientation=turned,
        gain=(fx, fy, fz, tx, ty, tz),
    )


def _placed(surface: Surface, bench: Bench) -> Surface:
    return Placed(surface, np.asarray(bench.turn), _move(bench))


def _move(bench: Bench) -> Float[np.ndarray, "3"]:
    return np.asarray(bench.pivot + bench.shift - bench.turn @ bench.pivot)


def _setup(setup: SetupType, bench: Bench, surface: Surface) -> SetupType:
    parts: dict[str, object] = {
        "rod": _rod(setup.rod, bench),
        "sensor": _sensor(setup.sensor, bench),
        "surface": surface,
    }
    # What a file said of an earlier calibration no longer holds.
    parts |= {field.name: None for field in fields(cast(Any, setup)) if field.name == "calibration"}
    return cast(SetupType, replace(cast(Any, setup), **parts))


def _estimate(
    parameter: Parameter,
    setup: SetupLike,
    bench: Bench,
    deviations: Mapping[str, float],
    held: Mapping[str, tuple[str, ...]],
) -> Estimate:
    given, value = _values(parameter, setup, bench)
    holds_for = tuple(name for name, others in held.items() if parameter.name in others)
    deviation = float(deviations.get(parameter.name, math.nan))
    return Estimate(
        parameter.name,
        parameter.unit,
        given,
        value,
        deviation,
        parameter.name in deviations,
        holds_for,
    )


def _values(parameter: Parameter, setup: SetupLike, bench: Bench) -> tuple[float, float]:
    """Given and calibrated."""
    rod, sensor = setup.rod, setup.sensor
    place = int(np.argmax(parameter.direction))
    match parameter.group:
        case "youngs_modulus" | "bending_stiffness":
            return _stiffness(parameter.group, rod.bending_stiffness, rod), _stiffness(
                parameter.group, float(bench.stiffness), rod
            )
        case "length":
            return rod.length, float(bench.length)
        case "clamp_position":
            return float(sensor.clamp_position[place - 2]), float(bench.clamp[place - 2])
        case "clamp_orientation":
            turned = Rotation.from_quat(sensor.clamp_orientation).inv() * Rotation.from_matrix(
                np.asarray(bench.axes)
            )
            return 0.0, float(turned.as_rotvec()[place - 5])
        case "object_position":
            return 0.0, float(bench.shift[place - 14])
        case "object_orientation":
            return 0.0, float(Rotation.from_matrix(np.asarray(bench.turn)).as_rotvec()[place - 17])
        case "standoff":
            return 0.0, float(bench.standoff)
    return float(sensor.gain[place - 8]), float(sensor.gain[place - 8] * bench.gain[place - 8])
