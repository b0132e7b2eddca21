"""Exact single contacts by integration of the rod's equation (paper, eq. 10), for tests of the
inverse.

A rod bent by a force of its own choosing is made similar to one of length 1 that touches at a given
arc length.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import vibrissa as vb


@dataclass(frozen=True)
class BentRod:
    """Contact of a rod clamped at the origin, turned by an orientation; model units."""

    force: np.ndarray
    """F on the rod (3,)."""
    point: np.ndarray
    arc_length: float
    energy: float
    orientation: np.ndarray

    @property
    def moment(self) -> np.ndarray:
        """m0 (3,), about the clamp."""
        return -np.cross(self.point, self.force)

    @property
    def wrench(self) -> np.ndarray:
        """(f0, m0) (6,)."""
        return np.concatenate([-self.force, self.moment])


def bent_rod(
    force: float, delta: float, curvature: float, arc_length: float, turn: Rotation
) -> BentRod:
    """Bend a rod in its x-z plane by a force at δ from its tangent, until the curvature vanishes,
    and scale that to `arc_length`.
    """

    def rod(_s: float, y: np.ndarray) -> list[float]:
        return [np.sin(y[2]), np.cos(y[2]), y[3], force * np.sin(y[2] - delta), y[3] ** 2 / 2]

    def straightens(_s: float, y: np.ndarray) -> float:
        return y[3]

    straightens.terminal, straightens.direction = True, -1
    start = [0.0, 0.0, 0.0, curvature, 0.0]
    path = solve_ivp(
        rod, (0, 50), start, method="DOP853", events=straightens, rtol=1e-13, atol=1e-14
    )
    x, z, _, _, energy = path.y_events[0][0]
    scale = arc_length / path.t_events[0][0]
    direction = np.array([np.sin(delta), 0.0, np.cos(delta)])
    return BentRod(
        turn.apply(force / scale**2 * direction),
        turn.apply([x * scale, 0.0, z * scale]),
        arc_length,
        energy / scale,
        turn.as_quat(),
    )


def reactions_of(
    rods: list[BentRod], rod: vb.Rod, covariance: np.ndarray | None = None
) -> vb.Reactions:
    """Support reactions of rods in the units of `rod`, one row each; the covariance is given in
    model units.
    """
    units = np.repeat([rod.force_scale, rod.moment_scale], 3)
    wrench = np.array([part.wrench for part in rods]) * units
    trail = vb.Trail(np.zeros((len(rods), 3)), np.array([part.orientation for part in rods]))
    scaled = None if covariance is None else covariance * np.outer(units, units)
    return vb.Reactions(trail, wrench[:, :3], wrench[:, 3:], covariance=scaled)


_TURNS = Rotation.random(4, rng=np.random.default_rng(9))
TIP = [bent_rod(1.3, 2.4, 0.9, 1.0, _TURNS[0]), bent_rod(4.0, 3.3, 2.0, 1.0, _TURNS[1])]
TANGENTIAL = [bent_rod(2.0, 1.8, 1.5, 0.8, _TURNS[2]), bent_rod(6.0, 2.6, 3.0, 0.7, _TURNS[3])]
RODS = TIP + TANGENTIAL
