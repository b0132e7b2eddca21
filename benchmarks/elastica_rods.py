"""The rod of `real_rods.py` that tapers and is curved at rest, relaxed to rest under its ball by
PyElastica: a Cosserat rod of straight elements, stepped in time with damping.

In units with L = EI = ρA = 1 at the clamp. So that both compute the same rod: the first element is
centred on the clamp and held, so that bending begins there; and contact is where an element is
nearest to the ball, its force shared by the two nodes. (PyElastica's own `RodSphereContact`, as of
1.0, takes each element for one that begins at its middle: half an element farther out.) What
changes only the way to rest is chosen for speed: the sections' inertia, and damping.
"""

from dataclasses import dataclass
from typing import Any

import elastica as ea
import numba
import numpy as np
from elastica._rotations import _inv_rotate

import vibrissa as vb

PENALTY = 3e4
"""Stiffness of the contact [EI/L³]: the ball's surface yields by 1e-4 L under 3 EI/L²."""
_DAMPING = 8.0  # about twice the first angular frequency [1/T], T² = ρA L⁴/EI
_COURANT = 0.4
_STILL = 1e-5  # speed [L/T] that counts as rest: a shape within 1e-5 L of it
_SPEED = 0.5  # of the ball between poses [L/T]
_AT_ONCE, _LONGEST = 100, 60.0


class _Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
    pass


class _Ball(ea.NoForces):
    """Pushes elements out of a ball, whose centre is changed in place."""

    def __init__(self, center: np.ndarray, radius: float) -> None:
        super().__init__()
        self.center, self.radius = center, radius

    def apply_forces(self, system: Any, time: float = 0.0) -> None:  # noqa: ARG002
        """As `NoForces` has it."""
        _push(system.position_collection, self.center, self.radius, system.external_forces)


@numba.njit(cache=True)
def _push(position: Any, center: Any, radius: float, forces: Any) -> Any:
    """Add the forces of the ball on nodes (3, n + 1); return their moment of order zero and one:
    their sum, and that of the places where elements are touched, by the size of the force.
    """
    total, places, size = np.zeros(3), np.zeros(3), 0.0
    for i in range(position.shape[1] - 1):
        edge = position[:, i + 1] - position[:, i]
        share = np.dot(center - position[:, i], edge) / np.dot(edge, edge)
        share = min(max(share, 0.0), 1.0)
        place = position[:, i] + share * edge
        out = place - center
        distance = np.sqrt(np.dot(out, out))
        if distance < radius:
            force = PENALTY * (radius - distance) * out / distance
            forces[:, i] += (1 - share) * force
            forces[:, i + 1] += share * force
            total += force
            places += PENALTY * (radius - distance) * place
            size += PENALTY * (radius - distance)
    return total, places, size


@dataclass(frozen=True)
class Rest:
    """Equilibria at some poses, in units of length of the rod given.

    Attributes
    ----------
    point
        Where the ball is touched (n, 3): mean over elements, by their forces.
    force
        On the rod (n, 3) [EI/L²].
    tip
        (n, 3)
    nodes
        (n, elements, 3) from the clamp to the tip, but for the first node, which lies before it.
    rests
        Whether the rod came to rest (n,).
    steps
        Number of steps in all.
    """

    point: np.ndarray
    force: np.ndarray
    tip: np.ndarray
    nodes: np.ndarray
    rests: np.ndarray
    steps: int


def relaxed(
    rod: vb.Rod,
    center: np.ndarray,
    radius: float,
    start: np.ndarray,
    elements: int,
    softness: float = 1.0,
) -> Rest:
    """Rest at places of the ball's centre (n, 3), clamp axes, that is moved there from `start`
    along straight lines; `softness` divides the stiffness against shear and stretch.
    """
    unit = rod.length
    h = 1 / (elements - 0.5)
    own = _rod(rod, h, elements, softness)
    ball, size = np.array(start) / unit, radius / unit
    simulator = _Simulator()
    simulator.append(own)
    simulator.constrain(own).using(
        ea.FixedConstraint, constrained_position_idx=(0, 1), constrained_director_idx=(0,)
    )
    fastest = np.sqrt(own.shear_matrix[2, 2] / (np.pi * own.radius**2 * own.density)).max()
    dt = _COURANT * h / fastest
    simulator.dampen(own).using(
        ea.AnalyticalLinearDamper, uniform_damping_constant=_DAMPING, time_step=dt
    )
    simulator.add_forcing_to(own).using(_Ball, ball, size)
    simulator.finalize()
    stepper, time, steps = ea.PositionVerlet(), 0.0, 0
    kept: dict[str, list[Any]] = {name: [] for name in ("point", "force", "tip", "nodes", "rests")}
    for place in np.asarray(center) / unit:
        way = place - ball
        moving = max(1, round(np.linalg.norm(way) / _SPEED / dt))
        for _ in range(moving):
            ball += way / moving
            time = stepper.step(simulator, time, dt)
        ball[:] = place
        still, until = False, time + _LONGEST
        while not still and time < until:
            for _ in range(_AT_ONCE):
                time = stepper.step(simulator, time, dt)
            steps += _AT_ONCE
            still = bool(np.abs(own.velocity_collection).max() < _STILL)
        steps += moving
        at = own.position_collection
        force, places, load = _push(at, ball, size, np.zeros_like(at))
        out = places / load - ball if load else np.full(3, np.nan)
        point = ball + size * out / np.linalg.norm(out)
        kept["point"].append(point * unit)
        kept["force"].append(force)
        kept["tip"].append(own.position_collection[:, -1] * unit)
        kept["nodes"].append(own.position_collection[:, 1:].T * unit)
        kept["rests"].append(still)
    return Rest(**{name: np.array(rows) for name, rows in kept.items()}, steps=steps)


def _rod(rod: vb.Rod, h: float, elements: int, softness: float) -> ea.CosseratRod:
    """Elements of length h, the first centred on the clamp; taper and arc as of the rod."""
    edges = (np.arange(elements + 1) - 0.5) * h
    middles = np.maximum(edges[:-1] + h / 2, 0.0)
    thick = np.asarray(rod.radius_at(middles)) / rod.length
    points, axes = _arc(rod, edges)
    directors = np.moveaxis(axes, 0, -1)
    kappa = _inv_rotate(directors) / h
    # E and ρ that make EI and ρA one at the clamp.
    youngs, density = 4 / (np.pi * thick[0] ** 4), 1 / (np.pi * thick[0] ** 2)
    own = ea.CosseratRod.straight_rod(
        elements,
        points[0],
        np.array([0.0, 0.0, 1.0]),
        np.array([1.0, 0.0, 0.0]),
        h * elements,
        thick,
        density,
        youngs_modulus=youngs,
        shear_modulus=youngs / 2 / (1 + float(rod.poisson_ratio)),
        position=np.ascontiguousarray(points.T),
        directors=np.ascontiguousarray(directors),
        rest_kappa=kappa,
    )
    own.shear_matrix /= softness
    # Sections turn as slowly as elements stretch: the longest step is that of stretching.
    slow = (h / own.radius) ** 2
    own.mass_second_moment_of_inertia *= slow
    own.inv_mass_second_moment_of_inertia /= slow
    return own


def _arc(rod: vb.Rod, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n + 1, 3) at arc lengths [L] on the polygon of the arc at rest, whose edges are as
    long as the arc between them, and axes (n, 3, 3) of the edges, in rows.
    """
    u1, u2, _ = np.asarray(rod.rest.at(0.0)) * rod.length
    middles = (s[1:] + s[:-1]) / 2
    across = np.array([u2, -u1, 0.0]) / np.hypot(u1, u2)
    angle = np.hypot(u1, u2) * middles
    tangent = np.outer(np.sin(angle), across) + np.outer(np.cos(angle), [0.0, 0.0, 1.0])
    side = np.cross([0.0, 0.0, 1.0], across)
    third = np.cross(side, tangent)
    axes = np.stack([third, np.broadcast_to(side, third.shape), tangent], axis=1)
    points = np.vstack([np.zeros(3), np.cumsum(tangent * np.diff(s)[:, None], axis=0)])
    # The clamp is the middle of the first edge.
    return points - points[1] / 2, axes
