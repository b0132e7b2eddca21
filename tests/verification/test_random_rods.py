"""Tapered rods that are curved at rest, at random poses over a sphere and over an ellipsoid, against
shooting that is written down once more: the axes of the section as a quaternion, and the moment from
m' = −t × F.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root
from scipy.spatial.transform import Rotation
from shooting import Level, quadric

import vibrissa as vb

CLOSE = 1e-8
COUNT, RODS = 25, 6
SHIFTED = 1e-2
"""By how much the equilibria are moved before they are sought again, relative to each unknown."""
POISSON = 0.35


class Whisker(NamedTuple):
    """Linear taper, curvature κ = c₀ + c₁ s and the direction of bending, in units of the length."""

    taper: float
    curvature: tuple[float, float]
    roll: float

    @property
    def rod(self) -> vb.Rod:
        """In SI units: 60 mm long, 0.2 mm thick."""
        length, radius = 0.06, 1e-4
        rod = vb.Rod.tapered(
            length=length,
            base_radius=radius,
            tip_radius=radius * (1 - self.taper),
            youngs_modulus=3.3e9,
            poisson_ratio=POISSON,
        )
        c = np.array(self.curvature) / length ** np.array([1, 2])
        return rod.curved(vb.RestShape.polynomial(c, self.roll))


class Shot(NamedTuple):
    """A rod up to a contact: place, tangent, moment and energy there."""

    place: np.ndarray
    tangent: np.ndarray
    moment: np.ndarray
    energy: float


def shot(
    whisker: Whisker, pose: Rotation, moment: np.ndarray, force: np.ndarray, length: float
) -> Shot:
    """Integrate from a clamp at the origin, given the moment there, to an arc length."""
    tau, (c0, c1) = whisker.taper, whisker.curvature
    rest = np.array([-np.sin(whisker.roll), np.cos(whisker.roll), 0.0])

    def slope(s: float, y: np.ndarray) -> np.ndarray:
        w, q = y[3], y[4:7]
        cross = np.array([[0, -q[2], q[1]], [q[2], 0, -q[0]], [-q[1], q[0], 0]])
        axes = np.eye(3) + 2 * w * cross + 2 * cross @ cross
        own = axes.T @ y[7:10]
        strain = own * [1, 1, 1 + POISSON] / (1 - tau * s) ** 4
        spin = strain + (c0 + c1 * s) * rest
        t = axes[:, 2]
        turn = np.array([-q @ spin, *(w * spin + cross @ spin)]) / 2
        return np.concatenate([t, turn, -np.cross(t, force), [own @ strain / 2]])

    x, y, z, w = pose.as_quat()
    start = np.concatenate([np.zeros(3), [w, x, y, z], moment, [0.0]])
    end = solve_ivp(slope, (0, length), start, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    w, *xyz = end[3:7]
    return Shot(end[:3], Rotation.from_quat([*xyz, w]).apply([0, 0, 1]), end[7:10], float(end[10]))


def unbalanced(
    whisker: Whisker, level: Level, pose: Rotation, u: np.ndarray, *, tip: bool
) -> np.ndarray:
    """What m(0), f, p, s₁ (8,) leave of the conditions of contact (8,)."""
    p, n = u[4:7], level.normal(u[4:7])
    end = shot(whisker, pose, u[:3], u[3] * n, u[7])
    last = u[7] - 1 if tip else end.tangent @ n
    steepness = np.linalg.norm(level.gradient(p))
    return np.array([*end.moment, *(end.place - p), level.value(p) / steepness, last])


def equilibrium(
    whisker: Whisker, level: Level, pose: Rotation, guess: np.ndarray, *, tip: bool
) -> tuple[np.ndarray, Shot]:
    """m(0), f, p, s₁ (8,) from nearby, and the rod."""

    def left(u: np.ndarray) -> np.ndarray:
        return unbalanced(whisker, level, pose, u, tip=tip)

    found = root(left, guess, tol=1e-13, options={"eps": 1e-8}).x
    assert abs(left(found)).max() < 1e-10
    return found, shot(whisker, pose, found[:3], found[3] * level.normal(found[4:7]), found[7])


BALL, EGG = (0.3, 0.3, 0.3), (0.5, 0.3, 0.4)
"""Semi-axes: one kernel serves both."""


class Case(NamedTuple):
    """A scan, and the same in units of the rod."""

    whisker: Whisker
    level: Level
    scan: vb.Scan


def cases(semi_axes: tuple[float, ...], seed: int) -> list[Case]:
    """Clamps that approach an object sideways until the straight rod would reach its middle."""
    random, found = np.random.default_rng(seed), []
    for number in range(RODS):
        taper, c0, c1, roll = random.uniform([0.3, -0.5, -0.5, -3], [0.8, 0.7, 0.7, 3])
        whisker = Whisker(taper, (c0, c1), roll)
        turn = Rotation.random(rng=random)
        # The object lies beside the straight rod, or in front of its tip.
        aside = turn.apply([*random.normal(size=2), 0.0])
        aside /= np.linalg.norm(aside)
        ahead = random.uniform(0.75, 0.95) + 0.35 * (number % 2)
        center = turn.apply([0.0, 0.0, ahead]) + 0.45 * aside
        surface = vb.surfaces.Ellipsoid(center=center * 0.06, semi_axes=np.array(semi_axes) * 0.06)
        level = quadric(center, semi_axes)
        path = np.linspace(-0.3, 0.45, COUNT)[:, None] * aside
        trail = vb.Trail(path * 0.06, turn.as_quat())
        found.append(Case(whisker, level, vb.scan(whisker.rod, surface, trail)))
    return found


@pytest.mark.parametrize(
    "semi_axes",
    [pytest.param(BALL, marks=pytest.mark.slow, id="ball"), pytest.param(EGG, id="egg")],
)
def test_equilibria_are_those_of_independent_shooting(semi_axes: tuple[float, ...]) -> None:
    """A light contact of each rod, one in the middle of its trail and the last."""
    kinds, random = set(), np.random.default_rng(3)
    for whisker, level, scan in cases(semi_axes, 11):
        rod, rows = scan.rod, np.flatnonzero(scan.in_contact & scan.solved)
        assert len(rows) > 3
        for row in rows[[1, len(rows) // 2, -1]]:
            clamp, pose = scan.trail.position[row] / rod.length, scan.trail.rotation[row]
            force = scan.reactions.force[row] / rod.force_scale
            moment = scan.reactions.moment[row] / rod.moment_scale
            reach, s = scan.point[row] / rod.length - clamp, scan.arc_length[row] / rod.length
            tip = bool(scan.kind[row] == vb.ContactKind.TIP)
            kinds.add(tip)
            state = np.array([*-moment, np.linalg.norm(force), *reach, s])
            guess = state * (1 + SHIFTED * random.uniform(-1, 1, 8))
            moved = Level(
                lambda p, c=clamp, level=level: level.value(p + c),
                lambda p, c=clamp, level=level: level.gradient(p + c),
            )
            exact, end = equilibrium(whisker, moved, Rotation.from_matrix(pose), guess, tip=tip)
            np.testing.assert_allclose(state, exact, rtol=0, atol=CLOSE)
            np.testing.assert_allclose(scan.contact_tangent[row], end.tangent, atol=CLOSE)
            np.testing.assert_allclose(
                scan.energy[row] / rod.moment_scale, end.energy, rtol=0, atol=CLOSE
            )
    assert kinds == {True, False}
