"""What rod, clamp and sensor may be off by, as one vector: what the constraints say when that is
taken off, and their derivatives by it.

Errors are what is true less what is stated, in model units and clamp axes, but for gains, zeros and
drifts, which are the sensor's: the share by which a channel reads too much, its reading at rest in
model units, and the rate of that.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.geometry.rotation import rotation_matrices
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
_ZERO_STEPS = 3


class Frame(NamedTuple):
    """How the sensor sees the clamp: rotation from clamp to sensor axes, and from where torques are
    read to the clamp, sensor axes [L].
    """

    turn: Float[np.ndarray, "3 3"]
    arm: Float[np.ndarray, "3"]

    @property
    def to_sensor(self) -> Float[np.ndarray, "6 6"]:
        """(f, m) about the clamp in its axes to readings: τ = m + arm × f."""
        matrix = np.zeros((6, 6))
        matrix[:3, :3] = matrix[3:, 3:] = self.turn
        matrix[3:, :3] = np.cross(self.arm, self.turn, axisb=0).T
        return matrix


def frame_of(reactions: Reactions, length: float) -> Frame:
    """As the reactions say; else that of a sensor at the clamp, in its axes."""
    errors = getattr(reactions, "setup_errors", None)
    if errors is None:
        return Frame(np.eye(3), np.zeros(3))
    return Frame(rotation_matrices(errors.clamp_orientation), np.asarray(errors.arm) / length)


@dataclass(frozen=True, eq=False)
class Bench:
    """Stretches in contact, and how they were measured.

    Attributes
    ----------
    stretches
        In contact, all of them.
    frame
        Of the sensor.
    tared
        Time to which the zero belongs.
    rest
        (3, 3) from clamp to world axes as the zero was taken.
    """

    stretches: Stretches
    frame: Frame
    tared: float
    rest: Float[np.ndarray, "3 3"]

    def taken(self, errors: BenchErrors) -> Float[np.ndarray, "6 6"]:
        """What takes measured wrenches, and their noise, to those with the errors taken off, but
        for what is added to them.
        """
        there, back = self.frame.to_sensor, np.linalg.inv(self.frame.to_sensor)
        turn = Rotation.from_rotvec(errors[ROTATION]).as_matrix().T
        both, moved = np.zeros((6, 6)), np.eye(6)
        both[:3, :3] = both[3:, 3:] = turn
        moved[3:, :3] = -np.cross(errors[POSITION], np.eye(3), axisb=0).T
        return np.asarray(
            np.exp(-errors[STIFFNESS]) * both @ moved @ (back / (1 + errors[GAIN])) @ there
        )

    def wrench(self, errors: BenchErrors) -> Float[np.ndarray, "k 6"]:
        """Base wrenches in true clamp axes and in units of the true stiffness and the stated
        length.
        """
        there, back = self.frame.to_sensor, np.linalg.inv(self.frame.to_sensor)
        elapsed = (self.stretches.time - self.tared)[:, None]
        reading = (self.stretches.wrench @ there.T - errors[ZERO] - elapsed * errors[DRIFT]) / (
            1 + errors[GAIN]
        )
        own = reading @ back.T
        force, moment = own[:, :3], own[:, 3:] - np.cross(errors[POSITION], own[:, :3])
        turn = Rotation.from_rotvec(errors[ROTATION]).as_matrix()
        return (
            np.concatenate([force @ turn, moment @ turn], axis=1) * np.exp(-errors[STIFFNESS])
            + self.reaction @ errors[LOAD]
        )

    @property
    def reaction(self) -> Float[np.ndarray, "6 3"]:
        """By load: what the straight rod's load made of the zero."""
        axes = self.rest.T
        return np.concatenate([-axes, -0.5 * np.cross([0.0, 0.0, 1.0], axes, axisb=0).T])

    def constraints(self, errors: BenchErrors) -> Constraints:
        """Of the rod with these errors taken off; s₁ and lengths in the stated one's."""
        axes = np.swapaxes(self.stretches.turn, 1, 2)
        rods = Imperfect(
            self.wrench(errors),
            np.full(len(axes), min(errors[TAPER], _MOST_TAPER)),
            np.tile(errors[CURVATURE], (len(axes), 1)),
            axes @ errors[LOAD],
        )
        return constraints_of(np.exp(errors[LENGTH]), rods)

    def slopes(self, here: Constraints, errors: BenchErrors) -> Slopes:
        """Derivatives of constraints (k, 4, 32) and points (k, 3, 32) by the errors."""
        wrench, base, count, eye = self.wrench(errors), here.by_wrench, len(here.value), np.eye(3)
        f, m = wrench[:, :3], wrench[:, 3:]
        there, back = self.frame.to_sensor, np.linalg.inv(self.frame.to_sensor)
        step = np.zeros((count, 6, ERRORS))
        # Couple and torsion are proportional to the wrench: their own noise must not look like a
        # stiffness, or like the gain of a channel that should read nothing.
        near = self._nearest(here, wrench)
        step[:, :, STIFFNESS] = -near
        step[:, 3:, POSITION] = _crossed(f)
        step[:, :3, ROTATION], step[:, 3:, ROTATION] = _crossed(f), _crossed(m)
        step[:, :, GAIN] = -back[None] * (near @ there.T)[:, None, :]
        step[:, :, ZERO] = -back
        step[:, :, DRIFT] = -back * (self.stretches.time - self.tared)[:, None, None]
        step[:, :, LOAD] = self.reaction
        found = base @ step
        constraints, point = found.constraints, found.point
        constraints[:, TIP, LENGTH] += here.steepness * np.exp(errors[LENGTH])
        point[:, :, POSITION] += eye
        point[:, :, ROTATION] -= _crossed(np.asarray(here.reach))
        axes = np.swapaxes(self.stretches.turn, 1, 2)
        for where, part in (
            (slice(TAPER, TAPER + 1), here.by_taper),
            (CURVATURE, here.by_curvature),
            (LOAD, here.by_load @ axes),
        ):
            constraints[:, :, where] += part.constraints
            point[:, :, where] += part.point
        return Slopes(constraints, point)

    def _nearest(
        self, here: Constraints, wrench: Float[np.ndarray, "k 6"]
    ) -> Float[np.ndarray, "k 6"]:
        """By the least change of the wrench that leaves neither couple nor torsion."""
        slope = here.by_wrench.constraints[:, :2]
        spread = self.stretches.noise @ np.swapaxes(slope, 1, 2)
        return np.asarray(
            wrench - (spread @ np.linalg.solve(slope @ spread, here.value[:, :2, None]))[:, :, 0]
        )


def _crossed(vector: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3 3"]:
    """Matrices that take e to −e × v."""
    return -np.swapaxes(np.cross(np.eye(3)[None], vector[:, None, :]), 1, 2)
