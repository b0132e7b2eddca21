"""Calibration without a known object: each contact is overdetermined, and so tells about rod, clamp
and sensor (mechanics.md, "What the data say about the setup").
"""

import math
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from vibrissa.calibration.bench import SetupLike, SetupType, Step, bench_of, moved_at_once
from vibrissa.calibration.held_out import HeldOut, Part, predicted_by_others
from vibrissa.calibration.parameters import Parameter, stepped, uncertain
from vibrissa.calibration.result import Calibration, Residuals, concluded
from vibrissa.calibration.rows import CalibrationError
from vibrissa.calibration.statistics import Fitness, opened
from vibrissa.calibration.verdict import moved, unpredicted
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse.checks.case import Case, Solution, case_of, solved
from vibrissa.inverse.checks.judgement import described, unjudged
from vibrissa.inverse.checks.rig import (
    ERRORS,
    FRICTION,
    GAIN,
    LENGTH,
    POSITION,
    ROTATION,
    RUBBING,
    STIFFNESS,
    sensor_matrix,
)
from vibrissa.inverse.checks.stretches import stretches_of
from vibrissa.inverse.reconstruct import reconstruct
from vibrissa.numerics.progress import Guess
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import Tolerances

_PLACES = {
    "stiffness": slice(STIFFNESS, STIFFNESS + 1),
    "length": slice(LENGTH, LENGTH + 1),
    "clamp": POSITION,
    "tilt": ROTATION,
    "gain": GAIN,
}
"""Where a step's numbers are in the errors of `inverse.checks`; any others are an object's."""
_SPREAD = 0.5
"""Prior standard deviation if none is given, in the parameters' scales: nothing is known then.
"""
_OPEN = 0.1
"""Standard deviation, in the parameters' scales, from which a direction counts as open: a tenth of
a stiffness or a rod length, 6°.
"""
_CONTRADICTED = 3.0
"""Mean square of the constraints, relative to noise, from which there is a warning: sound benches
show 1.4 at most, EI and L that make up for unstated friction 2.9.
"""


class Fit(NamedTuple):
    """The parameters determined, and those held, each with what it cannot be told apart from."""

    free: list[Parameter]
    held: dict[str, tuple[str, ...]]
    solution: Solution
    directions: Float[np.ndarray, "errors p"]
    spread: Float[np.ndarray, "p"]
    inflation: float


def calibrated_without_object(
    sweeps: list[Reactions],
    setup: SetupType,
    names: tuple[str, ...],
    chosen: list[Parameter],
    deviations: dict[str, float],
    friction: float,
    tolerances: Tolerances,
    steps: Guess,
) -> Calibration[SetupType]:
    """Rod, clamp and gains from sweeps over an unknown object.

    Parameters are as for `calibrate`. Tare errors are allowed for by their covariance, not
    estimated. What the data do not determine is fitted within its tolerance, if one is stated, so
    that what goes with it does not get too small a deviation.

    Raises
    ------
    ValueError
        If a parameter of an object is free.
    CalibrationError
        If the noise is not known, a recording has too little contact, or nothing is determined.
    """
    for one in chosen:
        if one.field not in _PLACES:
            raise ValueError(
                f"free: {one.group!r} needs the object, and surface = None; allowed are parameters "
                "of rod, clamp and sensor, tare and drift"
            )
    if note := unjudged(setup.rod):
        raise ValueError(f"surface = None: {note.partition(': ')[2]}; allowed is a known object")
    cases = []
    for index, sweep in enumerate(sweeps):
        cases.append(_case(index, sweep, setup, friction))
        steps.step()
    within = {
        one: deviation
        for one, deviation in uncertain(setup.rod, tolerances).items()
        if one.field in _PLACES
    }
    chosen = list(dict.fromkeys([*chosen, *within]))
    names = tuple(dict.fromkeys([*names, *(one.group for one in chosen)]))
    fit = _fitted(cases, chosen, deviations, within, setup)
    return _result(setup, names, chosen, fit, friction, tolerances if within else None, within)


def _case(index: int, reactions: Reactions, setup: SetupLike, friction: float) -> Case:
    rod, sensor = setup.rod, setup.sensor
    if reactions.covariance is None:
        raise CalibrationError(
            f"recordings[{index}]: the sensor's noise is not known; give force_noise and "
            "torque_noise"
        )
    averaged = stretches_of(reconstruct(rod, reactions, friction=friction, check=False))
    turn = rotation_matrices(sensor.clamp_orientation)
    to_sensor = sensor_matrix(turn, sensor.arm / rod.length)
    case = averaged and case_of(averaged, to_sensor, friction, rod=described(rod))
    if case is None:
        raise CalibrationError(
            f"recordings[{index}]: too little of it is in contact, or its signal too weak, to say "
            "anything about the rod"
        )
    return case


def _directions(free: list[Parameter], setup: SetupType) -> Float[np.ndarray, "errors p"]:
    """Errors of the bench for unit steps of parameters."""
    places, out = np.arange(ERRORS), np.zeros((ERRORS, len(free)))
    for column, one in enumerate(free):
        out[places[_PLACES[one.field]][list(one.entries)], column] = 1.0
    turn = rotation_matrices(setup.sensor.clamp_orientation)
    out[POSITION] = turn.T @ out[POSITION] / setup.rod.length
    return out


def _fitted(
    cases: list[Case],
    chosen: list[Parameter],
    deviations: dict[str, float],
    within: dict[Parameter, float],
    setup: SetupType,
) -> Fit:
    """Solve; hold what the solution leaves open, and solve again without it."""
    free, held = list(chosen), dict[str, tuple[str, ...]]()
    given = bench_of(setup.rod, setup.sensor).numbers(setup.sensor)
    while free:
        known = [
            min(
                deviations.get(one.group, math.inf) / one.slope(given),
                within.get(one, math.inf),
                _SPREAD * one.scale,
            )
            for one in free
        ]
        spread, directions = np.array(known), _directions(free, setup)
        solution = solved(cases, directions, spread, np.zeros(len(free)))
        left = np.concatenate([misfit.value for misfit in solution.misfits])
        inflation = max(1.0, float(left @ left) / max(len(left) - len(free), 1))
        more = opened(free, np.linalg.inv(solution.covariance * inflation), _OPEN)
        if not more:
            return Fit(free, held, solution, directions, spread, inflation)
        free, held = [one for one in free if one.name not in more], held | more
    raise CalibrationError(
        f"these recordings determine none of the free parameters: {', '.join(held)}"
    )


def _result(
    setup: SetupType,
    names: tuple[str, ...],
    chosen: list[Parameter],
    fit: Fit,
    friction: float,
    tolerances: Tolerances | None,
    within: dict[Parameter, float],
) -> Calibration[SetupType]:
    start = bench_of(setup.rod, setup.sensor)
    step: Step = stepped(fit.free, fit.solution.size, start)
    # Errors of gains are relative, steps logarithmic.
    step = step._replace(gain=np.log1p(step.gain))
    bench = jax.tree.map(np.asarray, moved_at_once(start, step))
    given, covariance = start.numbers(setup.sensor), fit.solution.covariance * fit.inflation
    estimates, own, identified = concluded(
        setup, chosen, fit.free, fit.held, bench, covariance,
        alone=1 / np.sqrt(np.diag(np.linalg.inv(covariance))),
        slopes=np.array([one.slope(given) for one in fit.free]),
    )  # fmt: skip
    parts, count = _held_out(fit), len(fit.solution.cases)
    nothing, unknown = np.zeros((count, 6)), np.full((count, 6), np.nan)
    lines = moved(chosen, estimates, setup.rod, within)
    if fit.inflation >= _CONTRADICTED:
        lines.append(
            "the constraints contradict each other by up to "
            f"{math.sqrt(fit.inflation):.2g} times what the noise explains, and what was freed "
            "does not mend it: free more, or check the rod's straightness and taper, friction, and "
            "the sensor"
        )
    return Calibration(
        setup=bench.setup(setup, setup.surface),
        surface=None,
        estimates=estimates,
        covariance=own,
        identifiability=identified,
        residuals=_residuals(setup.rod, fit.solution),
        fitness=Fitness(fit.inflation, 1.0, np.full(6, fit.inflation), 0.0, 0.0),
        tare=nothing,
        tare_deviation=unknown,
        drift=nothing,
        drift_deviation=unknown,
        pivot=np.zeros(3),
        pose=(np.eye(3), np.zeros(3)),
        friction=friction,
        unevenness=0.0,
        free=names,
        warnings=[*lines, *unpredicted(parts, fit.inflation)],
        held_out=parts,
        first_contact=np.full(count, np.nan),
        tolerances=tolerances,
    )


def _held_out(fit: Fit) -> tuple[HeldOut, ...]:
    """Each of several sweeps, predicted from the others; its own friction, where that is open, adds
    to its noise.
    """
    parts = []
    for index, (case, misfit) in enumerate(
        zip(fit.solution.cases, fit.solution.misfits, strict=True)
    ):
        rubbing = misfit.whitened(case.slopes.constraints @ RUBBING) * case.spread[FRICTION]
        root = np.linalg.cholesky(np.eye(len(misfit.value)) + rubbing @ rubbing.T)
        design, left = (
            solve_triangular(root, part, lower=True)
            for part in (
                misfit.whitened(case.slopes.constraints @ fit.directions),
                misfit.value,
            )
        )
        told = int(np.count_nonzero(misfit.told))
        parts.append(Part(f"recordings[{index}]", told, told, -design, left))
    total = np.diag(fit.spread**-2.0) + sum(part.design.T @ part.design for part in parts)
    return predicted_by_others(parts if len(parts) > 1 else [], total, fit.free, fit.inflation)


def _residuals(rod: Rod, solution: Solution) -> Residuals:
    """Stretches as rows; their three constraints are the first three columns of `whitened`."""
    units, columns = np.repeat([rod.force_scale, rod.moment_scale], 3), []
    for index, (case, misfit) in enumerate(zip(solution.cases, solution.misfits, strict=True)):
        own, there = case.bench.stretches, case.bench.to_sensor
        slope, value = (
            part[misfit.holds].reshape(-1, 3, *part.shape[2:])
            for part in (case.here.by_wrench.constraints, case.here.value)
        )
        spread = own.noise @ np.swapaxes(slope, 1, 2)
        # By the smallest change of the wrench that satisfies the constraints.
        change = (spread @ np.linalg.solve(slope @ spread, value[..., None]))[..., 0]
        whitened = np.pad(misfit.value.reshape(-1, 3), ((0, 0), (0, 3)))
        reading, predicted = (
            wrench @ there.T * units for wrench in (own.wrench, own.wrench - change)
        )
        columns.append((np.full(len(own.time), index), own.time, reading, predicted, whitened))
    recording, time, reading, predicted, whitened = map(np.concatenate, zip(*columns, strict=True))
    ones = np.ones(len(time))
    return Residuals(
        recording, time, ones > 0, reading, predicted, whitened, ones, np.sum(whitened**2, axis=1)
    )
