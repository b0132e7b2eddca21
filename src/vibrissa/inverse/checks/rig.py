"""What rod, clamp and sensor may be off by, as one vector; causes of error as users know them; and
what the constraints say when errors are taken off, with their derivatives.

Errors are what is true less what is stated, in model units and clamp axes, but for gains, zeros and
drifts, which are the sensor's: the share by which a channel reads too much, its reading at rest in
model units, and the rate of that.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from vibrissa.geometry.rotation import cross_matrices, rotation_matrices
from vibrissa.inverse.checks.constraints import TIP, Constraints, Slopes, constraints_of
from vibrissa.inverse.checks.stretches import Stretches
from vibrissa.mechanics.imperfect import Imperfect
from vibrissa.reactions import Reactions

STIFFNESS, LENGTH, TAPER = 0, 1, 14
POSITION, ROTATION, GAIN, CURVATURE, LOAD, DRIFT, ZERO = (
    slice(*pair) for pair in ((2, 5), (5, 8), (8, 14), (15, 17), (17, 20), (20, 26), (26, 32))
)
"""ln EI; ln L; the clamp's place [L] and turn; gains; share of the radius lost at the tip; rest
curvature [1/L]; load per length, world axes [EI/L³]; drift; zero.
"""
ERRORS = 32
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
"""Causes of error, and the errors for a unit of each of their numbers. In the order in which they
are named where they explain as much: what is known least comes first.
"""
TELLING = list(SUSPECTS)[:10]
"""Those that change all stretches alike: all but single channels. By these, phases are told."""
_SPREADS = np.repeat([0.3, 0.05, 0.04, 0.1, 0.1, 0.3, 0.0], [1, 1, 3, 3, 6, 6, 12])
"""Standard deviations before the data: gross mistakes are three of them. A stiffness by 30 %, a
length by 5 %, a clamp by 0.04 L and 6°, a gain by 10 %, taper, curvature and load by 0.3.
"""
_DRIFT_SPREAD, _ZERO_SPREAD = 20.0, 10.0
"""The same in standard deviations of a sample: of what a zero may drift over a contact, and be off
by.
"""


def spreads_of(sample: Float[np.ndarray, "6"], duration: float) -> BenchErrors:
    """Standard deviations before the data, for the noise of a sample (6), model units, and the
    contact's duration.
    """
    spreads = _SPREADS.copy()
    spreads[DRIFT], spreads[ZERO] = _DRIFT_SPREAD * sample / duration, _ZERO_SPREAD * sample
    return spreads


class Frame(NamedTuple):
    """How the sensor sees the clamp: rotation from clamp to sensor axes, and from where torques are
    read to the clamp, sensor axes [L].
    """

    turn: Float[np.ndarray, "3 3"]
    arm: Float[np.ndarray, "3"]

    @property
    def to_sensor(self) -> Float[np.ndarray, "6 6"]:
        """(f, m) about the clamp in its axes to readings: τ = m + arm × f."""
        matrix = np.kron(np.eye(2), self.turn)
        matrix[3:, :3] = cross_matrices(self.arm) @ self.turn
        return matrix


def frame_of(reactions: Reactions, length: float) -> Frame:
    """As the reactions say; else that of a sensor at the clamp, in its axes."""
    errors = reactions.setup_errors
    if errors is None:
        return Frame(np.eye(3), np.zeros(3))
    return Frame(rotation_matrices(errors.clamp_orientation), np.asarray(errors.arm) / length)


class Bench(NamedTuple):
    """Stretches in contact, and how they were measured."""

    stretches: Stretches
    """In contact, all of them."""
    frame: Frame
    tared: float
    """Time to which the zero belongs."""
    rest: Float[np.ndarray, "3 3"]
    """From clamp to world axes as the zero was taken."""

    def taken(self, errors: BenchErrors) -> Float[np.ndarray, "6 6"]:
        """What takes measured wrenches, and their noise, to those with the errors taken off, but
        for what is added to them.
        """
        there, back = self.frame.to_sensor, np.linalg.inv(self.frame.to_sensor)
        turned = np.kron(
            np.eye(2), scipy.spatial.transform.Rotation.from_rotvec(errors[ROTATION]).as_matrix().T
        )
        moved = np.eye(6)
        moved[3:, :3] = -cross_matrices(errors[POSITION])
        gained = (back / (1 + errors[GAIN])) @ there
        return np.asarray(np.exp(-errors[STIFFNESS]) * turned @ moved @ gained)

    def wrench(self, errors: BenchErrors) -> Float[np.ndarray, "k 6"]:
        """Base wrenches in true clamp axes and in units of the true stiffness and the stated
        length.
        """
        back = np.linalg.inv(self.frame.to_sensor)
        offset = errors[ZERO] + self._elapsed[:, None] * errors[DRIFT]
        return (self.stretches.wrench - offset @ back.T) @ self.taken(
            errors
        ).T + self.reaction @ errors[LOAD]

    @property
    def _elapsed(self) -> Float[np.ndarray, "k"]:
        """Since the zero was taken."""
        return self.stretches.time - self.tared

    @property
    def _axes(self) -> Float[np.ndarray, "k 3 3"]:
        """From world to clamp axes."""
        return np.swapaxes(self.stretches.turn, 1, 2)

    @property
    def reaction(self) -> Float[np.ndarray, "6 3"]:
        """By load: what the straight rod's load made of the zero."""
        axes = self.rest.T
        return np.concatenate([-axes, -0.5 * cross_matrices(np.array([0.0, 0.0, 1.0])) @ axes])

    def constraints(self, errors: BenchErrors) -> Constraints:
        """Of the rod with these errors taken off; s₁ and lengths in the stated one's."""
        wrench = self.wrench(errors)
        count = len(wrench)
        taper, curvature = min(errors[TAPER], _MOST_TAPER), errors[CURVATURE]
        rods = Imperfect(
            wrench, np.full(count, taper), np.tile(curvature, (count, 1)), self._axes @ errors[LOAD]
        )
        return constraints_of(np.exp(errors[LENGTH]), rods)

    def slopes(self, here: Constraints, errors: BenchErrors) -> Slopes:
        """Derivatives of constraints (k, 4, 32) and points (k, 3, 32) by the errors."""
        wrench, back = self.wrench(errors), np.linalg.inv(self.frame.to_sensor)
        f, m = cross_matrices(wrench[:, :3]), cross_matrices(wrench[:, 3:])
        # By the least change that leaves neither couple nor torsion. They are proportional to the
        # wrench: their own noise must not look like a stiffness, or like the gain of a channel
        # that should read nothing.
        slope = here.by_wrench.constraints[:, :2]
        spread = self.stretches.noise @ np.swapaxes(slope, 1, 2)
        near = wrench - (spread @ np.linalg.solve(slope @ spread, here.value[:, :2, None]))[:, :, 0]
        # By the numbers of the rod: wrench, taper, curvature, load.
        step = np.zeros((len(wrench), 12, ERRORS))
        step[:, :6, STIFFNESS] = -near
        step[:, 3:6, POSITION] = step[:, :3, ROTATION] = f
        step[:, 3:6, ROTATION] = m
        step[:, :6, GAIN] = -back * (near @ self.frame.to_sensor.T)[:, None, :]
        step[:, :6, ZERO], step[:, :6, DRIFT] = -back, -back * self._elapsed[:, None, None]
        step[:, :6, LOAD], step[:, 9:, LOAD] = self.reaction, self._axes
        step[:, 6, TAPER], step[:, 7:9, CURVATURE] = 1.0, np.eye(2)
        constraints, point = (part @ step for part in here.by_rod)
        constraints[:, TIP, LENGTH] += here.steepness * np.exp(errors[LENGTH])
        point[:, :, POSITION] += np.eye(3)
        point[:, :, ROTATION] -= cross_matrices(here.reach)
        return Slopes(constraints, point)
