"""What rod, clamp and sensor may be off by, as one vector; causes of error as users know them; and
the constraints with errors removed, with their derivatives.

Errors are true minus stated values, in model units and clamp axes, except gains, zeros and drifts,
which are the sensor's: the fraction by which a channel reads too much, its reading at rest in model
units, and the rate of that.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from vibrissa.geometry.rotation import cross_matrices
from vibrissa.inverse.arrays import Frame, Frames, Scalars, Spread, Vector, Wrench, Wrenches
from vibrissa.inverse.checks.constraints import (
    TANGENT,
    TIP,
    Constraints,
    Slopes,
    Stated,
    constraints_of,
)
from vibrissa.inverse.checks.stretches import Stretches
from vibrissa.mechanics.imperfect import Imperfect
from vibrissa.rod import Rod

STIFFNESS, LENGTH, TAPER, FRICTION = 0, 1, 14, 32
POSITION, ROTATION, GAIN, CURVATURE, LOAD, DRIFT, ZERO = (
    slice(*pair) for pair in ((2, 5), (5, 8), (8, 14), (15, 17), (17, 20), (20, 26), (26, 32))
)
"""ln EI; ln L; the clamp's position [L] and rotation; gains; fraction of the radius lost at the
tip; rest curvature [1/L]; load per length, world axes [EI/L³]; drift; zero; and the friction
coefficient, which is not an error.
"""
ERRORS = 33
BenchErrors = Float[np.ndarray, "errors"]
"""One number for each of these."""
Directions = Float[np.ndarray, "errors p"]
"""Errors for unit steps of some numbers."""
_MOST_TAPER = 0.8
"""Of the radius: beyond it a rod is a needle."""

_UNIT = np.eye(ERRORS)
SUSPECTS: dict[str, Directions] = {
    "bending_stiffness": _UNIT[:, [STIFFNESS]],
    "length": _UNIT[:, [LENGTH]],
    # Not about its own axis: the rod is round.
    "clamp_orientation": _UNIT[:, ROTATION][:, :2],
    "clamp_position": _UNIT[:, POSITION],
    "gain": _UNIT[:, GAIN].sum(axis=1, keepdims=True),
    "force_gain": _UNIT[:, GAIN][:, :3].sum(axis=1, keepdims=True),
    "torque_gain": _UNIT[:, GAIN][:, 3:].sum(axis=1, keepdims=True),
    "taper": _UNIT[:, [TAPER]],
    "rest_curvature": _UNIT[:, CURVATURE],
    "load": _UNIT[:, LOAD],
} | {
    f"{name}_{channel}": _UNIT[:, [where.start + index]]
    for name, where in (("gain", GAIN), ("drift", DRIFT), ("zero", ZERO))
    for index, channel in enumerate(("fx", "fy", "fz", "tx", "ty", "tz"))
}
"""Causes of error, and the errors for one unit of each of their numbers, in the order in which they
are named if they explain as much: the least well known comes first.
"""
TELLING = list(SUSPECTS)[:10]
"""Those that affect all stretches alike, all but single channels: these decide the phases."""
RUBBING: Directions = _UNIT[:, [FRICTION]]
_SPREADS = np.repeat([0.3, 0.05, 0.04, 0.1, 0.1, 0.3], [1, 1, 3, 3, 6, 6])
"""Prior standard deviations; gross mistakes are three of them. A stiffness by 30 %, a length by
5 %, a clamp by 0.04 L and 6°, a gain by 10 %, taper, curvature and load by 0.3.
"""
_DRIFT_SPREAD, _ZERO_SPREAD = 20.0, 10.0
"""The same in standard deviations of a sample: how much a zero may drift over a contact, and be off
by.
"""
_UNKNOWN_FRICTION, _KNOWN_FRICTION = 0.3, 0.2
"""The same for the friction coefficient: if none is stated, and relative to one that is."""
NOTHING = 1e-6
"""What keeps a number where it is: a spread, or a step."""


def spreads_of(sample: Wrench, duration: float, friction: float | None) -> BenchErrors:
    """Prior standard deviations, given the noise of a sample (6), model units, the contact's
    duration, and the stated friction, if any.
    """
    rubbing = _UNKNOWN_FRICTION if friction is None else max(_KNOWN_FRICTION * friction, NOTHING)
    zero = _DRIFT_SPREAD * sample / duration, _ZERO_SPREAD * sample
    return np.concatenate([_SPREADS, *zero, [rubbing]])


def sensor_matrix(turn: Frame, arm: Vector) -> Spread:
    """Matrix from (f, m) about the clamp, in its axes, to readings, τ = m + arm × f: given the
    rotation from clamp to sensor axes, and the arm from the torque reference point to the clamp,
    sensor axes [L].
    """
    matrix = np.kron(np.eye(2), turn)
    matrix[3:, :3] = cross_matrices(arm) @ turn
    return matrix


class Bench(NamedTuple):
    """Stretches in contact, and how they were measured."""

    stretches: Stretches
    """In contact, all of them."""
    to_sensor: Spread
    """From `sensor_matrix`."""
    tared: float
    """Time at which the zero was taken."""
    rest: Frame
    """From clamp to world axes when the zero was taken."""
    rubbing: Scalars | float = 0.0
    """t·n̂ for a friction coefficient of 1."""
    rod: Rod | None = None
    """As it is described; None for a straight uniform one."""
    leaning: float = np.inf
    """Largest cosine between force and rod before the tip."""

    @property
    def to_clamp(self) -> Spread:
        """The inverse."""
        return np.linalg.inv(self.to_sensor)

    def taken(self, errors: BenchErrors) -> Spread:
        """Matrix that removes the errors from measured wrenches, and from their noise, except for
        additive ones.
        """
        turned = scipy.spatial.transform.Rotation.from_rotvec(-errors[ROTATION]).as_matrix()
        moved = sensor_matrix(turned, -turned @ errors[POSITION])
        gained = (self.to_clamp / (1 + errors[GAIN])) @ self.to_sensor
        return np.asarray(np.exp(-errors[STIFFNESS]) * moved @ gained)

    def wrench(self, errors: BenchErrors) -> Wrenches:
        """Base wrenches, true clamp axes, in units of the true stiffness and the stated length."""
        offset = errors[ZERO] + self._elapsed[:, None] * errors[DRIFT]
        seen = self.stretches.wrench - offset @ self.to_clamp.T
        return seen @ self.taken(errors).T + self.reaction @ errors[LOAD]

    @property
    def _elapsed(self) -> Scalars:
        """Time since the zero was taken."""
        return self.stretches.time - self.tared

    @property
    def _axes(self) -> Frames:
        """From world to clamp axes."""
        return np.swapaxes(self.stretches.turn, 1, 2)

    @property
    def reaction(self) -> Float[np.ndarray, "6 3"]:
        """Derivative with respect to the load: what it did to the zero on the straight rod."""
        return -sensor_matrix(self.rest.T, np.array([0.0, 0.0, 0.5]))[:, :3]

    def constraints(self, errors: BenchErrors) -> Constraints:
        """Of the rod with these errors removed; s₁ and lengths in units of the stated length."""
        wrench = self.wrench(errors)
        count, taper = len(wrench), min(errors[TAPER], _MOST_TAPER)
        bend = np.tile(errors[CURVATURE], (count, 1))
        rods = Imperfect(wrench, np.full(count, taper), bend, self._axes @ errors[LOAD])
        here: Constraints = constraints_of(
            Stated(np.exp(errors[LENGTH]), self.rod, self.leaning), rods
        )
        value = here.value.copy()
        value[:, TANGENT] -= errors[FRICTION] * self.rubbing
        return here._replace(value=value)

    def slopes(self, here: Constraints, errors: BenchErrors) -> Slopes:
        """Derivatives of constraints (k, 4, 33) and points (k, 3, 33) by the errors."""
        wrench, back = self.wrench(errors), self.to_clamp
        f, m = cross_matrices(wrench[:, :3]), cross_matrices(wrench[:, 3:])
        # About the nearest wrench with neither couple nor torsion. The derivatives are proportional
        # to the wrench: its noise must not look like a stiffness, or like the gain of a channel
        # that should read nothing.
        slope = here.by_wrench.constraints[:, :2]
        spread = self.stretches.noise @ np.swapaxes(slope, 1, 2)
        near = wrench - (spread @ np.linalg.solve(slope @ spread, here.value[:, :2, None]))[:, :, 0]
        # With respect to the rod's numbers: wrench, taper, curvature, load.
        step = np.zeros((len(wrench), 12, ERRORS))
        step[:, :6, STIFFNESS] = -near
        step[:, 3:6, POSITION] = step[:, :3, ROTATION] = f
        step[:, 3:6, ROTATION] = m
        step[:, :6, GAIN] = -back * (near @ self.to_sensor.T)[:, None, :]
        step[:, :6, ZERO], step[:, :6, DRIFT] = -back, -back * self._elapsed[:, None, None]
        step[:, :6, LOAD], step[:, 9:, LOAD] = self.reaction, self._axes
        step[:, 6, TAPER], step[:, 7:9, CURVATURE] = 1.0, np.eye(2)
        constraints, point = (part @ step for part in here.by_rod)
        constraints[:, TIP, LENGTH] += here.steepness * np.exp(errors[LENGTH])
        constraints[:, TANGENT, FRICTION] = -self.rubbing
        point[:, :, POSITION] += np.eye(3)
        point[:, :, ROTATION] -= cross_matrices(here.reach)
        return Slopes(constraints, point)
