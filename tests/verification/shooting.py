"""The forward problem by shooting: the rod's equation in space and Newton's method, without the
package's closed forms.

Kirchhoff's rod, straight when free, of isotropic section, unshearable and inextensible, in model
units L = EI = 1. Beyond the contact it carries nothing; up to it the internal force is the contact
force F, and with m the moment that the part beyond s exerts on the part before it

    r' = t,   t' = m × t,   m' = −t × F,   r(0) = P0,   t(0) = t0.

Nothing is said of a plane, of elliptic integrals, or of the base moment's direction. Unknown are
m(0), f, the contact point p and s₁; the conditions (paper, eqs. 7 to 13; mechanics.md, "Contact
conditions") are m(s₁) = 0, r(s₁) = p, g(p) = 0 with F = f ∇g/‖∇g‖ at p, and either s₁ = 1 (tip) or
t(s₁) · ∇g = 0 (tangential). The support reactions are f0 = −F and m0 = −m(0).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

_RTOL, _ATOL = 1e-12, 1e-13
_CONVERGED, _ITERATIONS = 1e-11, 30
_LARGEST_STEP = 0.3


class Level(NamedTuple):
    """A solid in NumPy: level function, positive outside, and its gradient; both take a point (3,)."""

    value: Callable[[np.ndarray], float]
    gradient: Callable[[np.ndarray], np.ndarray]

    def normal(self, point: np.ndarray) -> np.ndarray:
        """Outward unit normal at a point."""
        gradient = self.gradient(point)
        return gradient / np.linalg.norm(gradient)

    def normal_slope(self, point: np.ndarray) -> np.ndarray:
        """∂n/∂p (3, 3) by central differences: Newton's method needs it to a few digits only."""
        step = 1e-6 * np.eye(3)
        return np.stack(
            [(self.normal(point + d) - self.normal(point - d)) / 2e-6 for d in step], axis=1
        )

    def scaled(self, length: float) -> "Level":
        """The same solid seen in units of `length`."""
        return Level(lambda p: self.value(p * length) / length, lambda p: self.gradient(p * length))

    def placed(self, rotation: Rotation, translation: ArrayLike) -> "Level":
        """Turn about the origin, then move."""
        R, d = rotation.as_matrix(), np.asarray(translation)
        return Level(
            lambda p: self.value(R.T @ (p - d)), lambda p: R @ self.gradient(R.T @ (p - d))
        )


def quadric(center: ArrayLike, semi_axes: ArrayLike) -> Level:
    """Σ ((p − c)/a)² = 1: ellipsoid, or with an infinite semi-axis an elliptic cylinder."""
    c, weight = np.asarray(center), 1 / np.asarray(semi_axes) ** 2
    return Level(lambda p: float(np.sum(weight * (p - c) ** 2) - 1), lambda p: 2 * weight * (p - c))


def height_field(height: Callable[..., float], slope: Callable[..., tuple[float, float]]) -> Level:
    """The solid z > C(x, y), with ∂C/∂x and ∂C/∂y."""
    return Level(
        lambda p: height(p[0], p[1]) - p[2], lambda p: np.array([*slope(p[0], p[1]), -1.0])
    )


def paraboloid(a: float, b: float, h: float) -> Level:
    """The solid z > a x² + b y² + h."""
    return height_field(lambda x, y: a * x * x + b * y * y + h, lambda x, y: (2 * a * x, 2 * b * y))


@dataclass(frozen=True)
class Equilibrium:
    """An equilibrium in model units."""

    base_moment: np.ndarray
    """m(0), what the rod exerts on the clamp."""
    force: float
    point: np.ndarray
    arc_length: float
    normal: np.ndarray
    tangent: np.ndarray
    """t(s₁)."""
    residual: float

    @property
    def unknowns(self) -> np.ndarray:
        """m(0), f, p, s₁ as Newton's method holds them (8,)."""
        return np.concatenate([self.base_moment, [self.force], self.point, [self.arc_length]])


def clamp_tangent(quaternion: ArrayLike) -> np.ndarray:
    """t0: where a rotation (x, y, z, w) takes +z."""
    return Rotation.from_quat(quaternion).apply([0.0, 0.0, 1.0])


def rod_along(
    clamp: ArrayLike,
    tangent: ArrayLike,
    base_moment: ArrayLike,
    force: ArrayLike,
    arc_lengths: ArrayLike,
) -> np.ndarray:
    """(r, t, m, bending energy so far) at increasing arc lengths (k, 10): an initial value problem
    from the clamp.
    """
    fx, fy, fz = np.asarray(force, dtype=float).tolist()

    def slope(_s: float, at: np.ndarray) -> list[float]:
        # Written out, as it is called very often: t, m × t, F × t, m²/2.
        x, y, z, mx, my, mz = at[3:9].tolist()
        return [
            x, y, z, my * z - mz * y, mz * x - mx * z, mx * y - my * x,
            fy * z - fz * y, fz * x - fx * z, fx * y - fy * x, (mx * mx + my * my + mz * mz) / 2,
        ]  # fmt: skip

    s = np.atleast_1d(arc_lengths)
    start = np.concatenate([clamp, tangent, base_moment, [0.0]])
    return solve_ivp(
        slope, (0, s[-1]), start, method="DOP853", rtol=_RTOL, atol=_ATOL, t_eval=s
    ).y.T


def _shot(
    clamp: np.ndarray, tangent: np.ndarray, u: np.ndarray, force: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(r, t, m) at s₁ (9,), and by the variational equations its derivatives by m(0) and F (9, 6)
    and by s₁ (9,).
    """

    def slope(_s: float, y: np.ndarray) -> np.ndarray:
        # Columns: the rod itself, then its derivatives by m(0) and by F.
        z = y.reshape(3, 3, 7)
        t, m = z[1], z[2]
        turn, turned = _cross_matrix(m[:, 0]), _cross_matrix(t[:, 0])
        dt, dm = turn @ t, -turned @ forces
        dt[:, 1:] -= turned @ m[:, 1:]
        dm[:, 1:] += _cross_matrix(force) @ t[:, 1:]
        return np.concatenate([t, dt, dm]).ravel()

    forces = np.zeros((3, 7))
    forces[:, 0], forces[:, 4:] = force, np.eye(3)
    start = np.zeros((9, 7))
    start[:, 0] = np.concatenate([clamp, tangent, u[:3]])
    start[6:, 1:4] = np.eye(3)
    end = solve_ivp(slope, (0, u[7]), start.ravel(), method="DOP853", rtol=_RTOL, atol=_ATOL).y[
        :, -1
    ]
    rate = slope(0.0, end).reshape(9, 7)[:, 0]
    end = end.reshape(9, 7)
    return end[:, 0], end[:, 1:], rate


def _cross_matrix(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _conditions(
    level: Level, clamp: np.ndarray, tangent: np.ndarray, u: np.ndarray, *, tip: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual (8,), its Jacobian (8, 8) and t(s₁)."""
    f, p = u[3], u[4:7]
    n, dn = level.normal(p), level.normal_slope(p)
    end, derivative, rate = _shot(clamp, tangent, u, f * n)
    by = np.zeros((9, 8))
    by[:, :3], by[:, 3], by[:, 4:7], by[:, 7] = (
        derivative[:, :3],
        derivative[:, 3:] @ n,
        f * derivative[:, 3:] @ dn,
        rate,
    )
    r, t, m = end[:3], end[3:6], end[6:]
    steepness = np.linalg.norm(level.gradient(p))
    residual = np.concatenate([r - p, m, [level.value(p) / steepness, u[7] - 1 if tip else t @ n]])
    jacobian = np.zeros((8, 8))
    jacobian[:3], jacobian[3:6] = by[:3], by[6:]
    jacobian[:3, 4:7] -= np.eye(3)
    jacobian[6, 4:7] = n
    jacobian[7] = np.eye(8)[7] if tip else n @ by[3:6]
    if not tip:
        jacobian[7, 4:7] += t @ dn
    return residual, jacobian, t


def shoot(
    level: Level, clamp: ArrayLike, tangent: ArrayLike, guess: ArrayLike, *, tip: bool
) -> Equilibrium:
    """Newton's method on the shot's end.

    Parameters
    ----------
    level
        The solid, in model units.
    clamp, tangent
        P0 and t0 (3,).
    guess
        m(0), f, p, s₁ (8,).
    tip
        Whether the rod touches with its tip (s₁ = 1) or tangentially (t · n = 0).

    Raises
    ------
    ArithmeticError
        If the residual does not fall to 1e-11.
    """
    clamp, tangent, u = np.asarray(clamp, float), np.asarray(tangent, float), np.array(guess, float)
    for _ in range(_ITERATIONS):
        residual, jacobian, t = _conditions(level, clamp, tangent, u, tip=tip)
        largest = float(np.abs(residual).max())
        if largest < _CONVERGED:
            return Equilibrium(
                u[:3],
                float(u[3]),
                u[4:7],
                1.0 if tip else float(u[7]),
                level.normal(u[4:7]),
                t,
                largest,
            )
        step = np.linalg.solve(jacobian, residual)
        u -= step * min(1.0, _LARGEST_STEP / np.abs(step[4:]).max())
    raise ArithmeticError(
        f"residual {largest} after {_ITERATIONS} iterations from {np.asarray(guess)}"
    )


def follow(level: Level, clamps: np.ndarray, tangents: np.ndarray) -> list[Equilibrium | None]:
    """Equilibria along a path (n, 3), (n, 3) on the branch that begins at first contact; None while
    the rod is free.

    The next state is guessed from the last two. Tip contact turns tangential where the tip would
    pass beyond tangency, and back where the contact would slide off the tip. The path must begin
    free and must not meet a fold.
    """
    found: list[Equilibrium | None] = []
    for clamp, tangent in zip(clamps, tangents, strict=True):
        last = found[-1] if found else None
        if last is None:
            found.append(_first(level, clamp, tangent))
            continue
        before = found[-2] if len(found) > 1 else None
        guess = last.unknowns if before is None else 2 * last.unknowns - before.unknowns
        state = _admissible(level, clamp, tangent, guess, tip=last.arc_length == 1)
        found.append(state if state.force >= 0 else None)
    return found


def _first(level: Level, clamp: np.ndarray, tangent: np.ndarray) -> Equilibrium | None:
    """First contact, if the straight rod enters the solid: guessed as a cantilever, loaded where it
    is deepest.
    """
    s = np.linspace(0, 1, 1001)[1:]
    line = clamp + s[:, None] * tangent
    depth = np.array([-level.value(p) / np.linalg.norm(level.gradient(p)) for p in line])
    deepest = int(np.argmax(depth))
    if depth[deepest] < 0:
        return None
    n = level.normal(line[deepest])
    point, force = line[deepest] + depth[deepest] * n, 3 * depth[deepest] / s[deepest] ** 3
    guess = np.concatenate(
        [np.cross(line[deepest] - clamp, force * n), [force], point, [s[deepest]]]
    )
    return _admissible(level, clamp, tangent, guess, tip=bool(deepest == len(s) - 1))


def _admissible(
    level: Level, clamp: np.ndarray, tangent: np.ndarray, guess: np.ndarray, *, tip: bool
) -> Equilibrium:
    """Shoot for one kind of contact, and for the other if the result does not exist on the rod."""
    state = shoot(level, clamp, tangent, guess, tip=tip)
    allowed = state.tangent @ state.normal <= 0 if tip else state.arc_length <= 1
    return state if allowed else shoot(level, clamp, tangent, state.unknowns, tip=not tip)
