"""Calibration without a known object: what over-determines each contact tells of rod, clamp and sensor (mechanics.md, "What the data say of the setup")."""

import math
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.calibrate.parameters import Parameter
from vibrissa.calibrate.result import Calibration, Estimate, Residuals, SetupType
from vibrissa.calibrate.rows import CalibrationError
from vibrissa.calibrate.statistics import Fitness, Identifiability
from vibrissa.calibrate.suspects import uncertain
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.reactions import Reactions
from vibrissa.reconstruct import reconstruct
from vibrissa.reconstruct.checks.case import Case, Solution, case_of, solved
from vibrissa.reconstruct.checks.regression import Misfit
from vibrissa.reconstruct.checks.rig import ERRORS, GAIN, LENGTH, POSITION, ROTATION, STIFFNESS, Frame
from vibrissa.reconstruct.checks.stretches import stretches_of
from vibrissa.rod import Rod
from vibrissa.sensor import RawRecording, Sensor
from vibrissa.tolerances import Tolerances

_GROUPS = (
    "youngs_modulus",
    "bending_stiffness",
    "length",
    "clamp_position",
    "clamp_orientation",
    "gain",
    "force_gain",
    "torque_gain",
    "tare",
    "drift",
)
_SPREAD = 0.5
"""Standard deviation before the data where no prior is given, in the parameters' scales: nothing is known."""
_OPEN = 0.1
"""Standard deviation, in the parameters' scales, from which a direction counts as open: a tenth of a stiffness or a rod length, 6°."""
_ALIKE = 0.05


class _Fit(NamedTuple):
    """The parameters that are determined, and those that are held, each with what it goes with."""

    free: list[Parameter]
    held: dict[str, tuple[str, ...]]
    solution: Solution
    covariance: Float[np.ndarray, "p p"]
    inflation: float


def calibrated_without_object(
    recordings: list[Reactions | RawRecording],
    setup: SetupType,
    names: tuple[str, ...],
    chosen: list[Parameter],
    deviations: dict[str, float],
    friction: float,
    tolerances: Tolerances,
) -> Calibration[SetupType]:
    """Rod, clamp and gains from sweeps over an object that is not known.

    Parameters are as of `calibrate`. Errors of the tares are allowed for by their covariance, not estimated. What is not determined is fitted within its tolerance, where
    one is stated, so that what goes with it has no smaller deviation.

    Raises
    ------
    ValueError
        If a parameter of an object is free.
    CalibrationError
        If the noise is not known, a recording has too little contact, or nothing is determined.
    """
    wrong = [parameter.group for parameter in chosen if parameter.group not in _GROUPS]
    if wrong:
        raise ValueError(f"free: {wrong[0]!r} needs the object, and surface = None; allowed are {', '.join(_GROUPS)}")
    cases = [
        _case(index, reactions, setup.rod, setup.sensor, friction) for index, reactions in enumerate(_sweeps(recordings, setup.sensor))
    ]
    stated = {
        parameter.name: (parameter, deviation) for parameter, deviation in uncertain(setup.rod, tolerances) if parameter.group in _GROUPS
    }
    chosen = [*chosen, *(parameter for name, (parameter, _) in stated.items() if name not in {one.name for one in chosen})]
    names = (*names, *dict.fromkeys(parameter.group for parameter in chosen if parameter.group not in names))
    within = {name: deviation for name, (_, deviation) in stated.items()}
    fit = _fit(cases, chosen, deviations, within, setup, friction)
    return _result(setup, names, chosen, cases, fit, friction, tolerances if within else None)


def _sweeps(recordings: list[Reactions | RawRecording], sensor: Sensor) -> list[Reactions]:
    given = [sensor.reactions(recording) if isinstance(recording, RawRecording) else recording for recording in recordings]
    if not given:
        raise ValueError("recordings = []; allowed is at least one recording")
    for one in given:
        if not isinstance(one, Reactions) or one.force.ndim != 2:
            raise ValueError("recordings: without an object allowed are single sweeps, as Reactions (`read_recording`) or RawRecording")
    return given


def _case(index: int, reactions: Reactions, rod: Rod, sensor: Sensor, friction: float) -> Case:
    if reactions.covariance is None:
        raise CalibrationError(f"recordings[{index}]: the sensor's noise is not known; give force_noise and torque_noise")
    averaged = stretches_of(reconstruct(rod, reactions, friction=friction, check=False))
    frame = Frame(rotation_matrices(sensor.clamp_orientation), (sensor.clamp_position - np.asarray(sensor.wrench_point)) / rod.length)
    case = None if averaged is None else case_of(averaged, frame, friction)
    if case is None:
        raise CalibrationError(f"recordings[{index}]: too little of it is in contact, or its signal too weak, to tell of the rod")
    return case


def _directions(parameters: list[Parameter], setup: SetupType) -> Float[np.ndarray, "32 p"]:
    """Errors of the bench for unit steps of parameters."""
    out, turn = np.zeros((ERRORS, len(parameters))), rotation_matrices(setup.sensor.clamp_orientation)
    for column, parameter in enumerate(parameters):
        step = parameter.direction
        out[[STIFFNESS, LENGTH], column] = step[:2]
        out[POSITION, column], out[ROTATION, column], out[GAIN, column] = turn.T @ step[2:5] / setup.rod.length, step[5:8], step[8:14]
    return out


def _fit(
    cases: list[Case],
    chosen: list[Parameter],
    deviations: dict[str, float],
    within: dict[str, float],
    setup: SetupType,
    friction: float,
) -> _Fit:
    """Solve; hold what the solution leaves open, one by one, and solve anew without it."""
    free, held = list(chosen), dict[str, tuple[str, ...]]()
    while free:
        scales = np.array([parameter.scale for parameter in free])
        factors = np.array([_factor(parameter, setup) for parameter in free])
        prior = np.array([deviations.get(parameter.group, math.inf) for parameter in free]) / factors
        tolerated = np.array([within.get(parameter.name, math.inf) for parameter in free])
        spread = np.minimum(np.minimum(prior, tolerated), _SPREAD * scales)
        solution = solved(cases, _directions(free, setup), spread, friction, np.zeros(len(free)))
        rows = sum(len(misfit.value) for misfit in solution.misfits)
        square = sum(float(misfit.value @ misfit.value) for misfit in solution.misfits)
        inflation = max(1.0, square / max(rows - len(free), 1))
        covariance = solution.covariance * inflation
        values, vectors = np.linalg.eigh(covariance / np.outer(scales, scales))
        if values[-1] < _OPEN**2:
            return _Fit(free, held, solution, covariance, inflation)
        loading = np.abs(vectors[:, -1])
        place = int(np.flatnonzero(loading > loading.max() - _ALIKE)[-1])
        held[free[place].name] = tuple(free[index].name for index in np.flatnonzero(loading > _ALIKE) if index != place)
        del free[place]
    raise CalibrationError(f"these recordings determine none of the free parameters: {', '.join(held)}")


def _factor(parameter: Parameter, setup: SetupType) -> float:
    """Change of an estimate for a unit step of its parameter."""
    rod = setup.rod
    match parameter.group:
        case "bending_stiffness":
            return rod.bending_stiffness
        case "youngs_modulus":
            assert rod.radius is not None
            return rod.bending_stiffness / (math.pi / 4 * rod.radius**4)
        case "length":
            return rod.length
    return 1.0


def _result(
    setup: SetupType,
    names: tuple[str, ...],
    chosen: list[Parameter],
    cases: list[Case],
    fit: _Fit,
    friction: float,
    tolerances: Tolerances | None,
) -> Calibration[SetupType]:
    names_left = {parameter.name for parameter in fit.free}
    held = {name: tuple(other for other in others if other in names_left) for name, others in fit.held.items()}
    sizes = dict(zip((parameter.name for parameter in fit.free), fit.solution.size, strict=True))
    factors = np.array([_factor(parameter, setup) for parameter in fit.free])
    covariance = fit.covariance * np.outer(factors, factors)
    deviations = dict(zip((parameter.name for parameter in fit.free), np.sqrt(np.diag(covariance)), strict=True))
    estimates = {parameter.name: _estimate(parameter, setup, sizes, deviations, held) for parameter in chosen}
    scales = np.array([parameter.scale for parameter in fit.free])
    spread = np.sqrt(np.diag(fit.covariance))
    values, vectors = np.linalg.eigh(fit.covariance / np.outer(scales, scales))
    known = Identifiability(
        names=tuple(parameter.name for parameter in fit.free),
        correlation=fit.covariance / np.outer(spread, spread),
        directions=vectors.T[::-1],
        deviations=np.sqrt(np.maximum(values[::-1], 0.0)),
        alone=1 / np.sqrt(np.diag(np.linalg.inv(fit.covariance))),
        held=held,
    )
    nothing = np.zeros((len(cases), 6))
    return Calibration(
        setup=_changed(setup, fit),
        surface=None,
        estimates=estimates,
        covariance=covariance,
        identifiability=known,
        residuals=_residuals(setup, fit.solution),
        fitness=Fitness(fit.inflation, 1.0, np.full(6, fit.inflation), 0.0, 0.0),
        tare=nothing,
        tare_deviation=np.full_like(nothing, np.nan),
        drift=nothing,
        drift_deviation=np.full_like(nothing, np.nan),
        pivot=np.zeros(3),
        pose=(np.eye(3), np.zeros(3)),
        friction=friction,
        unevenness=0.0,
        free=names,
        warnings=[],
        held_out=(),
        first_contact=np.full(len(cases), np.nan),
        tolerances=tolerances,
    )


def _estimate(
    parameter: Parameter, setup: SetupType, sizes: dict[str, float], deviations: dict[str, float], held: dict[str, tuple[str, ...]]
) -> Estimate:
    place = int(np.argmax(parameter.direction))
    match parameter.group:
        case "youngs_modulus" | "bending_stiffness" | "length":
            given = _factor(parameter, setup)
        case "clamp_position":
            given = float(setup.sensor.clamp_position[place - 2])
        case "clamp_orientation":
            given = 0.0
        case _:
            given = float(setup.sensor.gain[place - 8])
    step = float(sizes.get(parameter.name, 0.0))
    relative = parameter.group not in ("clamp_position", "clamp_orientation")
    value = given * math.exp(step) if relative and parameter.group[:4] != "gain" else given * (1 + step) if relative else given + step
    holds_for = tuple(name for name, others in held.items() if parameter.name in others)
    deviation = float(deviations.get(parameter.name, math.nan))
    return Estimate(parameter.name, parameter.unit, given, value, deviation, parameter.name in deviations, holds_for)


def _changed(setup: SetupType, fit: _Fit) -> SetupType:
    errors = _directions(fit.free, setup) @ fit.solution.size
    rod, sensor = setup.rod, setup.sensor
    turn = Rotation.from_quat(sensor.clamp_orientation)
    fx, fy, fz, tx, ty, tz = (float(gain * (1 + error)) for gain, error in zip(sensor.gain, errors[GAIN], strict=True))
    parts: dict[str, object] = {
        "rod": replace(
            rod, bending_stiffness=rod.bending_stiffness * math.exp(errors[STIFFNESS]), length=rod.length * math.exp(errors[LENGTH])
        ),
        "sensor": replace(
            sensor,
            clamp_position=sensor.clamp_position + turn.apply(errors[POSITION]) * rod.length,
            clamp_orientation=(turn * Rotation.from_rotvec(errors[ROTATION])).as_quat(),
            gain=(fx, fy, fz, tx, ty, tz),
        ),
    }
    if hasattr(setup, "calibration"):
        parts["calibration"] = None
    return cast(SetupType, replace(cast(Any, setup), **parts))


def _residuals(setup: SetupType, solution: Solution) -> Residuals:
    """Stretches as rows; the three constraints of each are the first three columns of `whitened`."""
    units = np.repeat([setup.rod.force_scale, setup.rod.moment_scale], 3)
    parts = [_rows(index, case, misfit, units) for index, (case, misfit) in enumerate(zip(solution.cases, solution.misfits, strict=True))]
    recording, time, reading, predicted, whitened = (np.concatenate(column) for column in zip(*parts, strict=True))
    count = len(time)
    return Residuals(recording, time, np.ones(count, dtype=bool), reading, predicted, whitened, np.ones(count), np.sum(whitened**2, axis=1))


def _rows(index: int, case: Case, misfit: Misfit, units: Float[np.ndarray, "6"]) -> tuple[np.ndarray, ...]:
    there, wrench = case.bench.frame.to_sensor, case.bench.stretches.wrench
    slope = np.take_along_axis(case.here.by_wrench.constraints, misfit.pick[:, :, None], axis=1)
    value = np.take_along_axis(case.here.value, misfit.pick, axis=1)
    spread = case.bench.stretches.noise @ np.swapaxes(slope, 1, 2)
    nearest = wrench - (spread @ np.linalg.solve(slope @ spread, value[:, :, None]))[:, :, 0]
    whitened = np.concatenate([misfit.value.reshape(-1, 3), np.zeros((len(wrench), 3))], axis=1)
    time = case.bench.stretches.time
    return np.full(len(time), index), time, wrench @ there.T * units, nearest @ there.T * units, whitened
