"""What else could be other than stated: how each number that is held would change the readings, and
what is said of it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d

from vibrissa.calibration.arrays import Columns, Vectors, Wrenches
from vibrissa.calibration.bench import Bench
from vibrissa.calibration.imperfections import Load, curving, tapering
from vibrissa.calibration.parameters import uncertain
from vibrissa.calibration.problem import Linear, Problem, by_turn
from vibrissa.calibration.rows import Rows
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.tolerances import Tolerances

_NEIGHBOURS = 9
"""Rows over which a velocity is averaged, which takes the pose's noise to a fifth."""
_FARTHEST = 2.0
"""Rod lengths, and turns of the tip [rad], beyond which differences have no bound: there the force
turns from drawing to pushing the rod."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """Numbers that are held and change the readings together.

    Attributes
    ----------
    name
        What they are.
    columns
        (n, 6, m) change of the readings for a unit of each.
    scale
        What makes them relative: lengths to the rod's, a delay to the time in which the sensor
        moves by that, a curvature to the turn of the tip.
    least
        Relative size from which they matter: below lie the model and what real objects are true to.
    tolerance
        What they may be off by as stated.
    said
        What their value means, in words.
    remedy
        What to do if they are other than stated.
    linear
        Whether other errors are not easily taken for it: taper and curvature, to first order only,
        also take up an uneven object.
    """

    name: str
    columns: Columns
    scale: float
    least: float
    tolerance: float
    said: Callable[[np.ndarray], str]
    remedy: str
    linear: bool = True


def suspects(problem: Problem, linear: Linear, rod: Rod, tolerances: Tolerances) -> list[Suspect]:
    """Causes that are not free, of which the data may tell."""
    length, rows = rod.length, problem.rows
    free = {one.group for one in problem.free}
    speeds = np.linalg.norm(_velocity(rows)[0][rows.contact], axis=1)
    torque = linear.by_step.gain[..., 3:].sum(axis=-1, keepdims=True)

    def place(value: np.ndarray) -> str:
        size = float(np.linalg.norm(value))
        along = (np.round(value / size, 2) + 0.0).tolist()
        return (
            f"the object seems to lie {length_text(size, rod)} from where it is stated, "
            f"along {along}"
        )

    def bend(value: np.ndarray) -> str:
        sagitta = float(np.linalg.norm(value)) * length**2 / 8
        return (
            f"the rod seems to be bent at rest, by a sagitta of about {length_text(sagitta, rod)}"
        )

    found = [
        Suspect(
            "object_scale", object_scale(linear)[..., None], 1.0, 0.002, tolerances.object_scale,
            lambda value: f"the object seems {abs(value[0]):.1%}"
            f" {'larger' if value[0] > 0 else 'smaller'} than stated",
            "state its size, or free standoff",
        ),
        Suspect(
            "object_position", linear.by_step.shift, 1 / length, 0.002,
            float(np.max(tolerances.object_position)), place,
            "state its place, or free object_position",
        ),
        Suspect(
            "torque_gain", torque, 1.0, 0.004, float(np.max(tolerances.gain[3:])),
            lambda value: f"torques seem to read {abs(value[0]):.1%}"
            f" too {'much' if value[0] > 0 else 'little'} against forces",
            "check the sensor's calibration, or free torque_gain",
        ),
        Suspect(
            "pose_delay", pose_delay(problem, linear)[..., None], float(np.median(speeds)) / length,
            0.002, tolerances.pose_delay,
            lambda value: f"poses seem to come {1e3 * abs(value[0]):.3g}"
            f" ms {'late' if value[0] > 0 else 'early'}",
            "state pose_delay",
        ),
    ]  # fmt: skip
    if problem.friction == 0:
        taper, curvature = _imperfections(problem, linear)
        found += [
            Suspect(
                "friction", _friction(problem, linear)[..., None], 1.0, 0.01, 0.0,
                lambda value: f"friction seems to be there, "
                f"of a coefficient of the order of {abs(value[0]):.1g}",
                "state friction",
            ),
            Suspect(
                "taper", taper, 1.0, 0.05, 0.0,
                lambda value: f"the rod seems to taper, its radius to be about {abs(value[0]):.0%}"
                f" {'smaller' if value[0] > 0 else 'larger'} at the tip",
                "calibration takes the rod to be uniform", linear=False,
            ),
            Suspect(
                "rest_curvature", curvature, length, 0.04, 0.0, bend,
                "calibration takes the rod to be straight", linear=False,
            ),
        ]  # fmt: skip
    freed = {
        "object_scale": {"standoff"},
        "object_position": {"object_position"},
        "torque_gain": {"gain", "torque_gain"},
    }
    return [one for one in found if not free & freed.get(one.name, set())]


def length_text(value: float, rod: Rod) -> str:
    """A length as said in a sentence."""
    return f"{1e3 * value:.2g} mm" if rod.units == "SI" else f"{value:.2g} L"


def held(problem: Problem, linear: Linear, rod: Rod, tolerances: Tolerances) -> Columns:
    """What one standard deviation of each number that is not fitted changes in the readings
    (n, 6, m): of those with a tolerance.
    """
    fitted = {one.name for one in problem.free}
    columns = [
        deviation * one.column(linear.by_step)
        for one, deviation in uncertain(rod, tolerances).items()
        if one.name not in fitted
    ]
    grown = object_scale(linear)
    if "standoff" in fitted:
        # Fitted is what an offset of the surface does; left is what growing does besides, nothing
        # for a ball.
        size = object_size(problem.surface, linear.bench, linear.reading.state.point)
        grown = grown - linear.by_step.standoff[..., 0] * size
    columns += [
        tolerances.object_scale * grown,
        tolerances.pose_delay * pose_delay(problem, linear),
    ]
    return np.stack(columns, axis=2)


def object_size(surface: Surface, bench: Bench, touched: Float[np.ndarray, "k 3"]) -> float:
    """How far off its pivot the object's surface lies where it is touched, along its normal, in the
    median: of a ball its radius.
    """
    return float(np.median(np.sum((touched - bench.pivot) * surface.normal(touched), axis=1)))


def _points(linear: Linear) -> Vectors:
    points = np.tile(linear.bench.center, (len(linear.contact), 1))
    points[linear.contact] = linear.reading.state.point
    return points


def object_scale(linear: Linear) -> Wrenches:
    """Change for an object that is larger, about its pivot, by a factor e: each contact goes along,
    and there the object keeps its normal.
    """
    return _by(linear.by_step.shift, _points(linear) - linear.bench.center)


def pose_delay(problem: Problem, linear: Linear) -> Wrenches:
    """Change for poses that come late by 1 s: the sensor has moved on, as if the object had moved
    back.
    """
    velocity, spin = _velocity(problem.rows)
    arm = linear.bench.center - problem.rows.pose.position
    return -_by(linear.by_step.shift, velocity) - _by(by_turn(linear.by_step, arm), spin)


def _friction(problem: Problem, linear: Linear) -> Wrenches:
    """Change for a unit of Coulomb's coefficient: the force leans against the sliding, as if the
    object were turned about the contact.

    Sliding is taken to be along the clamp's velocity; along the rod in tangential contact, and
    where it sticks, this is no more than a guess.
    """
    normal, velocity = _normals(problem, linear), _velocity(problem.rows)[0]
    sliding = velocity - np.sum(velocity * normal, axis=1, keepdims=True) * normal
    turn = np.cross(normal, -_directed(sliding))
    return _by(by_turn(linear.by_step, linear.bench.center - _points(linear)), turn)


def _imperfections(problem: Problem, linear: Linear) -> tuple[np.ndarray, np.ndarray]:
    """Changes by a unit of taper, and of curvature about both of the clamp's axes."""
    bench, contact = linear.bench, linear.contact
    axes = problem.rows.pose.axes[contact] @ bench.axes
    normal = _normals(problem, linear)[contact]
    force = linear.reading.state.force[:, None] * np.einsum("nij,ni->nj", axes, normal)
    load = Load(float(bench.length), float(bench.stiffness), force)
    shift, most = linear.by_step.clamp @ bench.axes, _FARTHEST * load.length

    def column(move: Float[np.ndarray, "contacts 3"], most: float) -> Wrenches:
        whole = np.zeros((len(contact), 3))
        whole[contact] = np.nan_to_num(np.clip(move, -most, most))
        return _by(shift, whole)

    curved = [column(curving(load, axis), most * load.length) for axis in (0, 1)]
    return column(tapering(load), most)[..., None], np.stack(curved, axis=2)


def _normals(problem: Problem, linear: Linear) -> Vectors:
    """Directions of the contact force on the rod, world axes: against the support's."""
    contact, bench = linear.contact, linear.bench
    normals = np.zeros((len(contact), 3))
    own = linear.reading.wrench[:, :3] / bench.gain[:3]
    normals[contact] = -_directed(_by(problem.rows.pose.axes[contact], own))
    return np.nan_to_num(normals)


def _directed(vectors: Vectors) -> Vectors:
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.maximum(size, np.finfo(float).tiny)


def _by(slope: Float[np.ndarray, "n k 3"], step: Vectors) -> np.ndarray:
    return np.einsum("nij,nj->ni", slope, step)


def _velocity(rows: Rows) -> tuple[Vectors, Vectors]:
    """Of the sensor [m/s] and [rad/s] in world axes, from lines through neighbouring rows; 0 at
    rest.
    """
    velocity, spin = np.zeros((len(rows.time), 3)), np.zeros((len(rows.time), 3))
    for recording in range(rows.recordings):
        own = np.flatnonzero(rows.contact & (rows.recording == recording))
        axes, time = rows.pose.axes[own], rows.seconds[own]
        place = np.concatenate([rows.pose.position[own], axes.reshape(-1, 9)], axis=1)

        def mean(values: np.ndarray) -> np.ndarray:
            return uniform_filter1d(values, _NEIGHBOURS, axis=0, mode="nearest")

        level = mean(time)
        covariance = mean(time[:, None] * place) - level[:, None] * mean(place)
        slope = covariance / np.maximum(mean(time**2) - level**2, np.finfo(float).tiny)[:, None]
        velocity[own] = slope[:, :3]
        # Half the sum of aₖ × ȧₖ over the axes' columns.
        spin[own] = np.cross(axes, slope[:, 3:].reshape(-1, 3, 3), axis=1).sum(axis=2) / 2
    return velocity, spin
