"""The fit of rod, clamp and gains to what over-determines the contacts of sweeps over an object
that is not known.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.calibration.parameters import Parameter
from vibrissa.calibration.result import SetupType
from vibrissa.calibration.rows import CalibrationError
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse.checks.case import Case, Solution, solved
from vibrissa.inverse.checks.rig import ERRORS, GAIN, LENGTH, POSITION, ROTATION, STIFFNESS

_SPREAD = 0.5
"""Standard deviation before the data where no prior is given, in the parameters' scales: nothing is
known.
"""
_OPEN = 0.1
"""Standard deviation, in the parameters' scales, from which a direction counts as open: a tenth of
a stiffness or a rod length, 6°.
"""
_ALIKE = 0.05


class Fit(NamedTuple):
    """The parameters that are determined, and those that are held, each with what it goes with."""

    free: list[Parameter]
    held: dict[str, tuple[str, ...]]
    solution: Solution
    spread: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    inflation: float


def directions_of(parameters: list[Parameter], setup: SetupType) -> Float[np.ndarray, "32 p"]:
    """Errors of the bench for unit steps of parameters."""
    out, turn = (
        np.zeros((ERRORS, len(parameters))),
        rotation_matrices(setup.sensor.clamp_orientation),
    )
    for column, parameter in enumerate(parameters):
        step = parameter.direction
        out[[STIFFNESS, LENGTH], column] = step[:2]
        out[POSITION, column], out[ROTATION, column], out[GAIN, column] = (
            turn.T @ step[2:5] / setup.rod.length,
            step[5:8],
            step[8:14],
        )
    return out


def fitted(
    cases: list[Case],
    chosen: list[Parameter],
    deviations: dict[str, float],
    within: dict[str, float],
    setup: SetupType,
    friction: float,
) -> Fit:
    """Solve; hold what the solution leaves open, one by one, and solve anew without it."""
    free, held = list(chosen), dict[str, tuple[str, ...]]()
    while free:
        scales = np.array([parameter.scale for parameter in free])
        factors = np.array([factor_of(parameter, setup) for parameter in free])
        prior = (
            np.array([deviations.get(parameter.group, math.inf) for parameter in free]) / factors
        )
        tolerated = np.array([within.get(parameter.name, math.inf) for parameter in free])
        spread = np.minimum(np.minimum(prior, tolerated), _SPREAD * scales)
        solution = solved(cases, directions_of(free, setup), spread, friction, np.zeros(len(free)))
        rows = sum(len(misfit.value) for misfit in solution.misfits)
        square = sum(float(misfit.value @ misfit.value) for misfit in solution.misfits)
        inflation = max(1.0, square / max(rows - len(free), 1))
        covariance = solution.covariance * inflation
        values, vectors = np.linalg.eigh(covariance / np.outer(scales, scales))
        if values[-1] < _OPEN**2:
            return Fit(free, held, solution, spread, covariance, inflation)
        loading = np.abs(vectors[:, -1])
        place = int(np.flatnonzero(loading > loading.max() - _ALIKE)[-1])
        held[free[place].name] = tuple(
            free[index].name for index in np.flatnonzero(loading > _ALIKE) if index != place
        )
        del free[place]
    raise CalibrationError(
        f"these recordings determine none of the free parameters: {', '.join(held)}"
    )


def factor_of(parameter: Parameter, setup: SetupType) -> float:
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
