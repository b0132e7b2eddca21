"""What else could be other than stated: how each number that is held would change the readings."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d

from vibrissa.calibration.equilibrium import CLAMP_AT, SHIFT_AT, STANDOFF_AT, TURN_AT, Bench
from vibrissa.calibration.fit import Linear, Point, Problem
from vibrissa.calibration.imperfections import Load, curving, tapering
from vibrissa.calibration.parameters import STIFFNESS, Parameter, parameters
from vibrissa.calibration.rows import Rows
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.tolerances import Tolerances

_NEIGHBOURS = 9
"""Rows over which a velocity is averaged."""

Columns = Float[np.ndarray, "contacts 6 m"]


@dataclass(frozen=True, eq=False)
class Suspect:
    """Numbers that are held and change the readings together.

    Attributes
    ----------
    name
        What they are.
    columns
        (contacts, 6, m) change of the readings in contact for a unit of each.
    scale
        What makes them relative: lengths to the rod's, a delay to the time in which the sensor
        moves by that.
    remedy
        What to do if they are other than stated.
    """

    name: str
    columns: Columns
    scale: float
    remedy: str


def suspects(problem: Problem, linear: Linear, rod: Rod) -> list[Suspect]:
    """Causes that are not free, of which the data may tell."""
    core, length = _core(linear), rod.length
    free = {parameter.group for parameter in problem.free}
    found = []
    if "standoff" not in free:
        found.append(
            Suspect(
                "object_scale",
                object_scale(linear)[:, :, None],
                1.0,
                "state its size, or free standoff",
            )
        )
    if "object_position" not in free:
        found.append(
            Suspect(
                "object_position",
                core[:, :, SHIFT_AT],
                1 / length,
                "state its place, or free object_position",
            )
        )
    if not free & {"gain", "torque_gain"}:
        (one,) = parameters(["torque_gain"], rod)
        found.append(
            Suspect(
                "torque_gain",
                (core @ one.direction)[:, :, None],
                1.0,
                "check the sensor's calibration, or free torque_gain",
            )
        )
    speed = float(
        np.median(np.linalg.norm(_velocity(problem.rows)[0][problem.rows.contact], axis=1))
    )
    found.append(
        Suspect(
            "pose_delay",
            pose_delay(problem, linear)[:, :, None],
            speed / length,
            "state pose_delay",
        )
    )
    if not problem.rubs:
        found.append(
            Suspect("friction", _friction(problem, linear)[:, :, None], 1.0, "state friction")
        )
        taper, curvature = _imperfections(problem, linear)
        found.append(Suspect("taper", taper, 1.0, "calibration takes the rod to be uniform"))
        found.append(
            Suspect("rest_curvature", curvature, length, "calibration takes the rod to be straight")
        )
    return found


def held(problem: Problem, linear: Linear, rod: Rod, tolerances: Tolerances) -> Columns:
    """What one standard deviation of each number that is not fitted changes in the readings
    (contacts, 6, m): of those with a tolerance.
    """
    fitted = {parameter.name for parameter in problem.free}
    core = _core(linear)
    columns = [
        core @ (one.direction * deviation)
        for one, deviation in uncertain(rod, tolerances)
        if one.name not in fitted
    ]
    if tolerances.object_scale > 0:
        grown = object_scale(linear)
        if "standoff" in fitted:
            # Fitted is what an offset of the surface does; left is what growing does besides,
            # nothing for a ball.
            grown = grown - core[:, :, STANDOFF_AT] * object_size(problem.surface, linear.point)
        columns.append(tolerances.object_scale * grown)
    if tolerances.pose_delay > 0:
        columns.append(tolerances.pose_delay * pose_delay(problem, linear))
    return np.stack(columns, axis=2) if columns else np.zeros((len(core), 6, 0))


def uncertain(rod: Rod, tolerances: Tolerances) -> list[tuple[Parameter, float]]:
    """Parameters of the bench with a tolerance, and this in their steps: ln EI, ln L, m, rad, ln
    gain.
    """
    stiffness = STIFFNESS[0] if rod.radius is not None else STIFFNESS[1]
    deviations: dict[str, list[float]] = {
        stiffness: [float(np.hypot(tolerances.youngs_modulus, 4 * tolerances.radius))],
        "length": [tolerances.length / rod.length],
        "clamp_position": tolerances.clamp_position.tolist(),
        "clamp_orientation": tolerances.clamp_orientation.tolist(),
        "gain": tolerances.gain.tolist(),
        "object_position": tolerances.object_position.tolist(),
    }
    pairs = [
        pair
        for name, values in deviations.items()
        for pair in zip(parameters([name], rod), values, strict=True)
    ]
    return [(parameter, float(deviation)) for parameter, deviation in pairs if deviation > 0]


def object_size(surface: Surface, point: Point) -> float:
    """How far off its pivot the object's surface lies where it is touched, along its normal, in the
    median: of a ball its radius.
    """
    touched = point.states[:, :3]
    return float(
        np.median(
            np.sum((touched - np.asarray(point.bench.pivot)) * surface.normal(touched), axis=1)
        )
    )


def _core(linear: Linear) -> Columns:
    return np.where(linear.readings.sound[:, None, None], linear.readings.jacobian, 0.0)


def object_scale(linear: Linear) -> Float[np.ndarray, "contacts 6"]:
    """Change for an object that is larger, about its pivot, by a factor e: each contact goes along,
    and there the object keeps its normal.
    """
    bench = linear.point.bench
    arm = linear.readings.state[:, :3] - np.asarray(bench.pivot + bench.shift)
    return _by(_core(linear)[:, :, SHIFT_AT], arm)


def pose_delay(problem: Problem, linear: Linear) -> Float[np.ndarray, "contacts 6"]:
    """Change for poses that come late by 1 s: the sensor has moved on, as if the object had moved
    back.
    """
    core, bench, rows = _core(linear), linear.point.bench, problem.rows
    velocity, spin = (part[rows.contact] for part in _velocity(rows))
    arm = np.asarray(bench.pivot + bench.shift) - rows.pose[rows.contact, :3]
    return -_by(core[:, :, SHIFT_AT], velocity + np.cross(spin, arm)) - _by(
        core[:, :, TURN_AT], spin
    )


def _friction(problem: Problem, linear: Linear) -> Float[np.ndarray, "contacts 6"]:
    """Change for a unit of Coulomb's coefficient: the force leans against the sliding, as if the
    object were turned about the contact.

    Sliding is taken to be along the clamp's velocity; along the rod in tangential contact, and
    where it sticks, this is no more than a guess.
    """
    core, bench, rows, found = _core(linear), linear.point.bench, problem.rows, linear.readings
    normal = _normals(problem, linear)
    velocity = _velocity(rows)[0][rows.contact]
    sliding = velocity - np.sum(velocity * normal, axis=1, keepdims=True) * normal
    sliding /= np.maximum(np.linalg.norm(sliding, axis=1, keepdims=True), np.finfo(float).tiny)
    turn = np.cross(normal, -sliding)
    arm = np.asarray(bench.pivot + bench.shift) - found.state[:, :3]
    return _by(core[:, :, SHIFT_AT], np.cross(turn, arm)) + _by(core[:, :, TURN_AT], turn)


def _imperfections(
    problem: Problem, linear: Linear
) -> tuple[Float[np.ndarray, "contacts 6 1"], Float[np.ndarray, "contacts 6 2"]]:
    bench, contact = linear.point.bench, problem.rows.contact
    axes = problem.rows.pose[contact, 3:12].reshape(-1, 3, 3) @ np.asarray(bench.axes)
    force = linear.readings.state[:, 3:4] * np.einsum("nij,ni->nj", axes, _normals(problem, linear))
    load = Load(float(bench.length), float(bench.stiffness), force)
    # Where the force turns from drawing to pushing the rod, differences would be without bound.
    most = 2 * load.length
    moves = [
        np.clip(tapering(load), -most, most),
        *(np.clip(curving(load, axis), -most * load.length, most * load.length) for axis in (0, 1)),
    ]
    shift = _core(linear)[:, :, CLAMP_AT] @ np.asarray(bench.axes)
    taper, *curved = (
        _by(shift, np.nan_to_num(move, nan=0.0, posinf=0.0, neginf=0.0)) for move in moves
    )
    return taper[:, :, None], np.stack(curved, axis=2)


def _normals(problem: Problem, linear: Linear) -> Float[np.ndarray, "contacts 3"]:
    """Directions of the contact force on the rod, world axes: against the support's."""
    bench: Bench = linear.point.bench
    axes = problem.rows.pose[problem.rows.contact, 3:12].reshape(-1, 3, 3)
    force = np.einsum(
        "nij,nj->ni", axes, linear.readings.wrench[:, :3] / np.asarray(bench.gain)[:3]
    )
    return np.nan_to_num(
        -force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), np.finfo(float).tiny)
    )


def _by(
    slope: Float[np.ndarray, "n 6 3"], step: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 6"]:
    return np.einsum("nij,nj->ni", slope, step)


def _velocity(rows: Rows) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Of the sensor [m/s] and [rad/s] in world axes, from lines through neighbouring rows; 0 at
    rest.
    """
    velocity, spin = np.zeros((len(rows.time), 3)), np.zeros((len(rows.time), 3))
    for recording in range(rows.recordings):
        own = np.flatnonzero(rows.contact & (rows.recording == recording))
        place, time = rows.pose[own, :12], rows.seconds[own]

        def mean(values: np.ndarray) -> np.ndarray:
            return uniform_filter1d(values, _NEIGHBOURS, axis=0, mode="nearest")

        level = mean(time)
        covariance = mean(time[:, None] * place) - level[:, None] * mean(place)
        slope = covariance / np.maximum(mean(time**2) - level**2, np.finfo(float).tiny)[:, None]
        velocity[own] = slope[:, :3]
        turning = slope[:, 3:].reshape(-1, 3, 3) @ np.swapaxes(place[:, 3:].reshape(-1, 3, 3), 1, 2)
        spin[own] = (
            np.stack(
                [
                    turning[:, 2, 1] - turning[:, 1, 2],
                    turning[:, 0, 2] - turning[:, 2, 0],
                    turning[:, 1, 0] - turning[:, 0, 1],
                ],
                axis=1,
            )
            / 2
        )
    return velocity, spin
