"""Calibration without a known object: what over-determines each contact tells of rod, clamp and
sensor (mechanics.md, "What the data say of the setup").
"""

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.spatial.transform import Rotation

from vibrissa.calibration.held_out import HeldOut, predicted_by_others
from vibrissa.calibration.parameters import Parameter
from vibrissa.calibration.result import Calibration, Estimate, Residuals, SetupType
from vibrissa.calibration.rows import CalibrationError
from vibrissa.calibration.statistics import Fitness, Identifiability
from vibrissa.calibration.suspects import uncertain
from vibrissa.calibration.unknown_object_fit import Fit, directions_of, factor_of, fitted
from vibrissa.calibration.verdict import moved, unpredicted
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse import reconstruct
from vibrissa.inverse.checks.case import Case, Misfit, Solution, case_of
from vibrissa.inverse.checks.rig import GAIN, LENGTH, POSITION, ROTATION, STIFFNESS, Frame
from vibrissa.inverse.checks.stretches import stretches_of
from vibrissa.reactions import Reactions
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
_CONTRADICTED = 3.0
"""Mean square of the constraints in that of noise from which it is said: sound benches show 1.4 at
most, EI and L that make up for friction that is not stated 2.9.
"""


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

    Parameters are as of `calibrate`. Errors of the tares are allowed for by their covariance, not
    estimated. What is not determined is fitted within its tolerance, where one is stated, so that
    what goes with it has no smaller deviation.

    Raises
    ------
    ValueError
        If a parameter of an object is free.
    CalibrationError
        If the noise is not known, a recording has too little contact, or nothing is determined.
    """
    wrong = [parameter.group for parameter in chosen if parameter.group not in _GROUPS]
    if wrong:
        raise ValueError(
            f"free: {wrong[0]!r} needs the object, and surface = None; allowed are {', '.join(_GROUPS)}"
        )
    cases = [
        _case(index, reactions, setup.rod, setup.sensor, friction)
        for index, reactions in enumerate(_sweeps(recordings, setup.sensor))
    ]
    stated = {
        parameter.name: (parameter, deviation)
        for parameter, deviation in uncertain(setup.rod, tolerances)
        if parameter.group in _GROUPS
    }
    chosen = [
        *chosen,
        *(
            parameter
            for name, (parameter, _) in stated.items()
            if name not in {one.name for one in chosen}
        ),
    ]
    names = (
        *names,
        *dict.fromkeys(parameter.group for parameter in chosen if parameter.group not in names),
    )
    within = {name: deviation for name, (_, deviation) in stated.items()}
    fit = fitted(cases, chosen, deviations, within, setup, friction)
    return _result(setup, names, chosen, fit, friction, tolerances if within else None, within)


def _sweeps(recordings: list[Reactions | RawRecording], sensor: Sensor) -> list[Reactions]:
    given = [
        sensor.reactions(recording) if isinstance(recording, RawRecording) else recording
        for recording in recordings
    ]
    if not given:
        raise ValueError("recordings = []; allowed is at least one recording")
    for one in given:
        if not isinstance(one, Reactions) or one.force.ndim != 2:
            raise ValueError(
                "recordings: without an object allowed are single sweeps, as Reactions (`read_recording`) or RawRecording"
            )
    return given


def _case(index: int, reactions: Reactions, rod: Rod, sensor: Sensor, friction: float) -> Case:
    if reactions.covariance is None:
        raise CalibrationError(
            f"recordings[{index}]: the sensor's noise is not known; give force_noise and torque_noise"
        )
    averaged = stretches_of(reconstruct(rod, reactions, friction=friction, check=False))
    frame = Frame(
        rotation_matrices(sensor.clamp_orientation),
        (sensor.clamp_position - np.asarray(sensor.wrench_point)) / rod.length,
    )
    case = None if averaged is None else case_of(averaged, frame, friction)
    if case is None:
        raise CalibrationError(
            f"recordings[{index}]: too little of it is in contact, or its signal too weak, to tell of the rod"
        )
    return case


def _result(
    setup: SetupType,
    names: tuple[str, ...],
    chosen: list[Parameter],
    fit: Fit,
    friction: float,
    tolerances: Tolerances | None,
    within: dict[str, float],
) -> Calibration[SetupType]:
    names_left = {parameter.name for parameter in fit.free}
    held = {
        name: tuple(other for other in others if other in names_left)
        for name, others in fit.held.items()
    }
    sizes = dict(zip((parameter.name for parameter in fit.free), fit.solution.size, strict=True))
    factors = np.array([factor_of(parameter, setup) for parameter in fit.free])
    covariance = fit.covariance * np.outer(factors, factors)
    deviations = dict(
        zip((parameter.name for parameter in fit.free), np.sqrt(np.diag(covariance)), strict=True)
    )
    estimates = {
        parameter.name: _estimate(parameter, setup, sizes, deviations, held) for parameter in chosen
    }
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
    stated = {
        parameter.name: within[parameter.name] * factor_of(parameter, setup)
        for parameter in chosen
        if parameter.name in within
    }
    parts = _held_out(setup, fit)
    nothing = np.zeros((len(fit.solution.cases), 6))
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
        warnings=[
            *moved(estimates.values(), setup.rod, stated),
            *_misfit(fit.inflation),
            *unpredicted(parts, fit.inflation),
        ],
        held_out=parts,
        first_contact=np.full(len(fit.solution.cases), np.nan),
        tolerances=tolerances,
    )


def _held_out(setup: SetupType, fit: Fit) -> tuple[HeldOut, ...]:
    """Each of several sweeps, predicted by the others; its own friction, where it is open, adds to
    its noise.
    """
    directions, found = directions_of(fit.free, setup), []
    for case, misfit in zip(fit.solution.cases, fit.solution.misfits, strict=True):
        rubbing = misfit.whitened(case.friction) * case.friction_spread
        root = np.linalg.cholesky(np.eye(len(misfit.value)) + rubbing @ rubbing.T)
        design = solve_triangular(
            root, misfit.whitened(case.slopes.constraints @ directions), lower=True
        )
        found.append(
            (
                design,
                solve_triangular(root, misfit.value, lower=True),
                int(np.count_nonzero(misfit.told)),
            )
        )
    total = np.diag(fit.spread**-2.0) + sum(design.T @ design for design, _, _ in found)
    parts = [
        predicted_by_others(
            f"recordings[{index}]", told, -design, left, 1, total, fit.free, fit.inflation
        )
        for index, (design, left, told) in enumerate(found)
        if len(found) > 1
    ]
    return tuple(part for part in parts if part is not None)


def _misfit(inflation: float) -> list[str]:
    """A line where the constraints, as fitted, contradict each other."""
    if inflation < _CONTRADICTED:
        return []
    return [
        f"the constraints contradict each other by up to {math.sqrt(inflation):.2g} times what the noise explains, and what was freed does not mend it: "
        "free more, or check the rod's straightness and taper, friction, and the sensor"
    ]


def _estimate(
    parameter: Parameter,
    setup: SetupType,
    sizes: dict[str, float],
    deviations: dict[str, float],
    held: dict[str, tuple[str, ...]],
) -> Estimate:
    place = int(np.argmax(parameter.direction))
    match parameter.group:
        case "youngs_modulus" | "bending_stiffness" | "length":
            given = factor_of(parameter, setup)
        case "clamp_position":
            given = float(setup.sensor.clamp_position[place - 2])
        case "clamp_orientation":
            given = 0.0
        case _:
            given = float(setup.sensor.gain[place - 8])
    step = float(sizes.get(parameter.name, 0.0))
    relative = parameter.group not in ("clamp_position", "clamp_orientation")
    value = (
        given * math.exp(step)
        if relative and parameter.group[:4] != "gain"
        else given * (1 + step)
        if relative
        else given + step
    )
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


def _changed(setup: SetupType, fit: Fit) -> SetupType:
    errors = directions_of(fit.free, setup) @ fit.solution.size
    rod, sensor = setup.rod, setup.sensor
    turn = Rotation.from_quat(sensor.clamp_orientation)
    fx, fy, fz, tx, ty, tz = (
        float(gain * (1 + error)) for gain, error in zip(sensor.gain, errors[GAIN], strict=True)
    )
    parts: dict[str, object] = {
        "rod": replace(
            rod,
            bending_stiffness=rod.bending_stiffness * math.exp(errors[STIFFNESS]),
            length=rod.length * math.exp(errors[LENGTH]),
        ),
        "sensor": sensor.updated(
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
    parts = [
        _rows(index, case, misfit, units)
        for index, (case, misfit) in enumerate(zip(solution.cases, solution.misfits, strict=True))
    ]
    recording, time, reading, predicted, whitened = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    count = len(time)
    return Residuals(
        recording,
        time,
        np.ones(count, dtype=bool),
        reading,
        predicted,
        whitened,
        np.ones(count),
        np.sum(whitened**2, axis=1),
    )


def _rows(
    index: int, case: Case, misfit: Misfit, units: Float[np.ndarray, "6"]
) -> tuple[np.ndarray, ...]:
    there, wrench = case.bench.frame.to_sensor, case.bench.stretches.wrench
    slope = np.take_along_axis(case.here.by_wrench.constraints, misfit.pick[:, :, None], axis=1)
    value = np.take_along_axis(case.here.value, misfit.pick, axis=1)
    spread = case.bench.stretches.noise @ np.swapaxes(slope, 1, 2)
    nearest = wrench - (spread @ np.linalg.solve(slope @ spread, value[:, :, None]))[:, :, 0]
    whitened = np.concatenate([misfit.value.reshape(-1, 3), np.zeros((len(wrench), 3))], axis=1)
    time = case.bench.stretches.time
    return (
        np.full(len(time), index),
        time,
        wrench @ there.T * units,
        nearest @ there.T * units,
        whitened,
    )
