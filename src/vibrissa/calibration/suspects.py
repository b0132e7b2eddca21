"""What else may not be as stated: how each number that is held would change the readings, and what
to say about it.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d

from vibrissa.calibration.arrays import Columns, Vectors, Wrenches
from vibrissa.calibration.bench import Bench
from vibrissa.calibration.form import REST, TAPER
from vibrissa.calibration.imperfections import imperfect_moves
from vibrissa.calibration.parameters import uncertain
from vibrissa.calibration.problem import Linear, by_rows
from vibrissa.calibration.rows import Rows
from vibrissa.inverse.checks.findings import length_text
from vibrissa.inverse.checks.rig import sensor_matrix
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.tolerances import Tolerances

_NEIGHBOURS = 9
"""Rows over which a velocity is averaged, which cuts the pose's noise to a fifth."""
_FARTHEST = 2.0
"""Largest difference, in rod lengths: they have no bound where the force turns from pulling to
pushing the rod.
"""


class Suspect(NamedTuple):
    """Numbers that are held and change the readings together."""

    name: str
    columns: Columns
    """Change of the readings for a unit of each."""
    scale: float
    """Factor that makes them relative: lengths to the rod's, a delay to the time in which the
    sensor moves that far, a curvature to the rotation of the tip.
    """
    least: float
    """Relative size from which they matter: model and real objects are no more accurate than
    this.
    """
    tolerance: float
    """Stated tolerance: what they may be off by."""
    said: Callable[[np.ndarray], str]
    """What their value means, in words."""
    remedy: str
    """What to do if they are not as stated."""
    freed: tuple[str, ...] = ()
    """Parameters that they stand in for."""
    linear: bool = True
    """Whether other errors are not easily mistaken for it: taper and curvature, to first order
    only, also absorb an uneven object.
    """


def suspects(linear: Linear, rod: Rod, tolerances: Tolerances) -> list[Suspect]:
    """Causes that are not free and that the data may reveal."""
    length, problem, step = rod.length, linear.problem, linear.reading.by_step
    speeds = np.linalg.norm(_velocity(problem.rows)[0][problem.rows.contact], axis=1)

    def place(value: np.ndarray) -> str:
        size = float(np.linalg.norm(value))
        along = (np.round(value / size, 2) + 0.0).tolist()
        return (
            f"the object seems to lie {length_text(size, rod)} from where it is stated, "
            f"along {along}"
        )

    found = [
        Suspect(
            "object_scale", object_scale(linear)[..., None], 1.0, 0.002, tolerances.object_scale,
            lambda value: f"the object seems {abs(value[0]):.1%}"
            f" {'larger' if value[0] > 0 else 'smaller'} than stated",
            "state its size, or free standoff", ("standoff",),
        ),
        Suspect(
            "object_position", step.shift, 1 / length, 0.002,
            float(tolerances.object_position.max()), place,
            "state its place, or free object_position", ("object_position",),
        ),
        Suspect(
            "torque_gain", step.gain[..., 3:].sum(axis=-1, keepdims=True), 1.0, 0.004,
            float(tolerances.gain[3:].max()),
            lambda value: f"torques seem to read {abs(value[0]):.1%}"
            f" too {'much' if value[0] > 0 else 'little'} compared with forces",
            "check the sensor's calibration, or free torque_gain", ("gain", "torque_gain"),
        ),
        Suspect(
            "pose_delay", pose_delay(linear)[..., None], float(np.median(speeds)) / length, 0.002,
            tolerances.pose_delay,
            lambda value: f"poses seem to come {1e3 * abs(value[0]):.3g}"
            f" ms {'late' if value[0] > 0 else 'early'}",
            "state pose_delay",
        ),
    ]  # fmt: skip
    if problem.friction == 0:
        imperfect = _imperfections(linear)
        found += [
            Suspect(
                "friction", _friction(linear)[..., None], 1.0, 0.01, 0.0,
                lambda value: f"there seems to be friction, "
                f"with a coefficient of the order of {abs(value[0]):.1g}",
                "state friction",
            ),
            Suspect(
                "taper", imperfect[..., :1], 1.0, 0.05, 0.0,
                lambda value: f"the rod seems to taper, with a radius about {abs(value[0]):.0%}"
                f" {'smaller' if value[0] > 0 else 'larger'} at the tip",
                "describe it, or free taper", TAPER, linear=False,
            ),
            Suspect(
                "rest_curvature", imperfect[..., 1:], length, 0.04, 0.0,
                lambda value: "the rod seems to be bent at rest, with a sagitta of about "
                + length_text(float(np.linalg.norm(value)) * length**2 / 8, rod),
                "describe it, or free rest_curvature and rest_roll", REST, linear=False,
            ),
        ]  # fmt: skip
        # What the rod as it is described does not have does nothing.
        found = [one for one in found if np.any(one.columns)]
    free = {one.group for one in problem.free}
    return [one for one in found if free.isdisjoint(one.freed)]


def held(linear: Linear, rod: Rod, tolerances: Tolerances) -> Columns:
    """How one standard deviation of each number that has a tolerance and is not fitted changes the
    readings (n, 6, m).
    """
    problem, step = linear.problem, linear.reading.by_step
    columns = [
        deviation * one.column(step)
        for one, deviation in uncertain(rod, tolerances).items()
        if one not in problem.free
    ]
    grown = object_scale(linear)
    if "standoff" in (one.name for one in problem.free):
        # What an offset of the surface does is fitted; what growing does beyond that remains,
        # nothing for a ball.
        size = object_size(problem.surface, linear.bench, linear.point.states.point)
        grown = grown - step.standoff[..., 0] * size
    columns += [tolerances.object_scale * grown, tolerances.pose_delay * pose_delay(linear)]
    return np.stack(columns, axis=2)


def object_size(surface: Surface, bench: Bench, touched: Float[np.ndarray, "k 3"]) -> float:
    """Median distance of the object's surface, where it is touched, from its pivot along the
    normal: for a ball, its radius.
    """
    return float(np.median(np.sum((touched - bench.pivot) * surface.normal(touched), axis=1)))


def object_scale(linear: Linear) -> Wrenches:
    """Change for an object that is larger, about its pivot, by a factor e: each contact moves with
    it, and the object keeps its normal there.
    """
    return by_rows(linear.reading.by_step.shift, linear.reading.state.point - linear.bench.center)


def pose_delay(linear: Linear) -> Wrenches:
    """Change for poses that come 1 s late: the sensor has moved on, as if the object had moved
    back.
    """
    rows, reading = linear.problem.rows, linear.reading
    velocity, spin = _velocity(rows)
    turn = reading.by_turn(linear.bench.center - rows.pose.position)
    return -by_rows(reading.by_step.shift, velocity) - by_rows(turn, spin)


def _friction(linear: Linear) -> Wrenches:
    """Change per unit of Coulomb's coefficient: the force leans against the sliding, as if the
    object were rotated about the contact.

    Sliding is taken to be along the clamp's velocity; for sliding along the rod in tangential
    contact, and where it sticks, this is no more than a guess.
    """
    reading, bench, rows = linear.reading, linear.bench, linear.problem.rows
    force = reading.wrench[:, :3] / bench.gain[:3]
    normal, velocity = -_directed(by_rows(rows.pose.axes, force)), _velocity(rows)[0]
    sliding = velocity - np.sum(velocity * normal, axis=1, keepdims=True) * normal
    turn = np.cross(normal, -_directed(sliding))
    return by_rows(reading.by_turn(bench.center - reading.state.point), turn)


def _imperfections(linear: Linear) -> Columns:
    """Changes per unit of taper, and of curvature towards both of the clamp's axes."""
    bench, reading = linear.bench, linear.reading
    if bench.form is not None:
        return np.concatenate([reading.by_step.taper, reading.by_step.rest], axis=2)
    to_sensor = sensor_matrix(bench.axes, (bench.clamp - bench.wrench_point) / bench.length)
    units = np.repeat([bench.length**2, bench.length], 3) / bench.stiffness / bench.gain
    wrench = reading.wrench[reading.sound] * units @ np.linalg.inv(to_sensor).T
    moves = np.zeros((len(reading.sound), 3, 3))
    moves[reading.sound] = np.clip(np.nan_to_num(imperfect_moves(wrench)), -_FARTHEST, _FARTHEST)
    return reading.by_step.clamp @ bench.axes @ moves * bench.length ** np.array([1, 2, 2])


def _directed(vectors: Vectors) -> Vectors:
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.maximum(size, np.finfo(float).tiny)


def _velocity(rows: Rows) -> tuple[Vectors, Vectors]:
    """Velocity [m/s] and spin [rad/s] of the sensor in world axes, from lines fitted to
    neighbouring rows; 0 at rest.
    """
    velocity, spin = np.zeros((2, len(rows.time), 3))
    for own in rows.contacts:
        axes, time = rows.pose.axes[own], rows.seconds[own, None]
        path = np.concatenate([time, rows.pose.position[own], axes.reshape(-1, 9)], axis=1)
        level, moment = (
            uniform_filter1d(part, _NEIGHBOURS, axis=0, mode="nearest")
            for part in (path, time * path)
        )
        covariance = moment - level[:, :1] * level
        slope = covariance[:, 1:] / np.maximum(covariance[:, :1], np.finfo(float).tiny)
        velocity[own] = slope[:, :3]
        # Half the sum of aₖ × ȧₖ over the axes' columns.
        spin[own] = np.cross(axes, slope[:, 3:].reshape(-1, 3, 3), axis=1).sum(axis=2) / 2
    return velocity, spin
