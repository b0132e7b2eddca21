"""The same tasks in SciPy, on the paper's case: rod along +z of unit length and stiffness, object z
> x²/2 + y² + 0.4.

The rod stays in the vertical plane through its clamp with azimuth ψ. With ξ the distance in that
plane from the clamp's axis and F = (Q cos ψ, Q sin ψ, N) the contact force, regular as it falls to
zero (paper, eqs. 7 to 10),

    ξ' = sin θ,   ζ' = cos θ,   θ' = κ,   κ' = N sin θ − Q cos θ,   ξ(0) = ζ(0) = θ(0) = 0,

and at the contact s₁: κ = 0, the point on the object, F parallel to its normal, and min(1 − s₁,
−t·n) = 0.
"""

from collections.abc import Iterator

import numpy as np
from scipy.integrate import solve_bvp, solve_ivp
from scipy.optimize import root

A, B, H = 0.5, 1.0, 0.4
_FIRST_MESH = np.linspace(0, 1, 11)


def contact_conditions(x0: float, y0: float, end: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Five conditions (5, …) on the end (ξ, ζ, θ, κ) and the unknowns (ψ, Q, N, s₁)."""
    xi, zeta, theta, kappa = end
    psi, Q, N, s1 = u
    c, s = np.cos(psi), np.sin(psi)
    x, y = x0 + xi * c, y0 + xi * s
    Cx, Cy = 2 * A * x, 2 * B * y
    lift = np.cos(theta) - np.sin(theta) * (c * Cx + s * Cy)
    surface = A * x * x + B * y * y + H - zeta
    return np.stack([kappa, surface, Q * c + N * Cx, Q * s + N * Cy, np.minimum(1 - s1, lift)])


def _condition_slopes(
    x0: float, y0: float, end: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the conditions with respect to the end (5, 4) and the unknowns (5, 4)."""
    xi, _, theta, _ = end
    psi, Q, N, s1 = u
    c, s, ct, st = np.cos(psi), np.sin(psi), np.cos(theta), np.sin(theta)
    x, y = x0 + xi * c, y0 + xi * s
    Cx, Cy = 2 * A * x, 2 * B * y
    slope, turn = c * Cx + s * Cy, -s * Cx + c * Cy
    bend, mixed = 2 * (A * c * c + B * s * s), 2 * (B - A) * xi * c * s
    tip = 1 - s1 < ct - st * slope
    by_end = np.array([
        [0, 0, 0, 1],
        [slope, -1, 0, 0],
        [2 * A * c * N, 0, 0, 0],
        [2 * B * s * N, 0, 0, 0],
        [0, 0, 0, 0] if tip else [-st * bend, 0, -st - ct * slope, 0],
    ])  # fmt: skip
    by_unknowns = np.array([
        [0, 0, 0, 0],
        [xi * turn, 0, 0, 0],
        [-Q * s - 2 * A * xi * s * N, c, Cx, 0],
        [Q * c + 2 * B * xi * c * N, s, Cy, 0],
        [0, 0, 0, -1] if tip else [-st * (turn + mixed), 0, 0, 0],
    ])  # fmt: skip
    return by_end, by_unknowns


def contact_point(x0: float, y0: float, end: np.ndarray, psi: float) -> np.ndarray:
    """Contact point (3,)."""
    return np.array([x0 + end[0] * np.cos(psi), y0 + end[0] * np.sin(psi), end[1]])


def first_guess(x0: float, y0: float) -> np.ndarray:
    """Return (ψ, Q, N, s₁) just after first contact, where the rod is still straight."""
    Cx, Cy = 2 * A * x0, 2 * B * y0
    f = 3 * (A * x0**2 + B * y0**2 + H - 1) / -(np.hypot(Cx, Cy) ** 2)
    return np.array([np.arctan2(Cy, Cx), f * np.hypot(Cx, Cy), -f, 1.0])


def bvp_along(positions: np.ndarray, *, exact_jacobians: bool = True) -> Iterator[np.ndarray]:
    """Contact points along a trail (n, 2) by `solve_bvp`, tol 1e-6, each started from the last
    mesh; Jacobians exact, or by SciPy's finite differences.

    The unknown length is scaled out, σ = s/s₁.
    """
    u, mesh, y = first_guess(*positions[0]), _FIRST_MESH, np.zeros((4, _FIRST_MESH.size))
    y[1] = mesh
    for x0, y0 in positions:

        def conditions(
            start: np.ndarray, end: np.ndarray, u: np.ndarray, x0: float = x0, y0: float = y0
        ) -> np.ndarray:
            return np.concatenate([start[:3], contact_conditions(x0, y0, end, u)])

        def slopes(
            _start: np.ndarray, end: np.ndarray, u: np.ndarray, x0: float = x0, y0: float = y0
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            by_start, by_end, by_unknowns = np.zeros((8, 4)), np.zeros((8, 4)), np.zeros((8, 4))
            by_start[:3, :3] = np.eye(3)
            by_end[3:], by_unknowns[3:] = _condition_slopes(x0, y0, end, u)
            return by_start, by_end, by_unknowns

        found = solve_bvp(
            _scaled_rod,
            conditions,
            mesh,
            y,
            p=u,
            tol=1e-6,
            **({"fun_jac": _scaled_rod_slopes, "bc_jac": slopes} if exact_jacobians else {}),
        )
        if not found.success:
            raise ArithmeticError(f"solve_bvp at {x0}, {y0}: {found.message}")
        u, mesh, y = found.p, found.x, found.y
        yield contact_point(x0, y0, y[:, -1], u[0])


def _scaled_rod(_sigma: np.ndarray, y: np.ndarray, u: np.ndarray) -> np.ndarray:
    sine, cosine = np.sin(y[2]), np.cos(y[2])
    return u[3] * np.stack([sine, cosine, y[3], u[2] * sine - u[1] * cosine])


def _scaled_rod_slopes(
    _sigma: np.ndarray, y: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    sine, cosine, s1 = np.sin(y[2]), np.cos(y[2]), u[3]
    by_state, by_unknowns = np.zeros((4, 4, y.shape[1])), np.zeros((4, 4, y.shape[1]))
    by_state[0, 2], by_state[1, 2] = s1 * cosine, -s1 * sine
    by_state[2, 3], by_state[3, 2] = s1, s1 * (u[2] * cosine + u[1] * sine)
    by_unknowns[3, 1], by_unknowns[3, 2] = -s1 * cosine, s1 * sine
    by_unknowns[:, 3] = _scaled_rod(_sigma, y, u) / s1
    return by_state, by_unknowns


def shooting_along(positions: np.ndarray) -> Iterator[np.ndarray]:
    """Contact points along a trail (n, 2) by `solve_ivp` (DOP853) and `root`, each started by
    extrapolating the last ones.

    The unknowns are (κ(0), ψ, Q, N, s₁); the rod and its perturbations for the Jacobian are
    integrated together, as one vectorised problem.
    """
    u = np.append(0.0, first_guess(*positions[0]))
    last = None
    for x0, y0 in positions:
        guess = u if last is None else 2 * u - last
        found = root(_shot, guess, args=(x0, y0), jac=True, tol=1e-10)
        if np.abs(found.fun).max() > 1e-8:
            raise ArithmeticError(f"root at {x0}, {y0}: {found.message}")
        last, u = u, found.x
        end = _ends(u[:, None])[:, 0]
        yield contact_point(x0, y0, end, u[1])


def _shot(u: np.ndarray, x0: float, y0: float) -> tuple[np.ndarray, np.ndarray]:
    step = 1e-6
    all_u = u[:, None] + step * np.hstack([np.zeros((5, 1)), np.eye(5)])
    values = contact_conditions(x0, y0, _ends(all_u), all_u[1:])
    return values[:, 0], (values[:, 1:] - values[:, :1]) / step


def _ends(u: np.ndarray) -> np.ndarray:
    """(ξ, ζ, θ, κ) at s₁ (4, k) for several sets of unknowns (5, k)."""
    k = u.shape[1]

    def rod(_sigma: float, y: np.ndarray) -> np.ndarray:
        return _scaled_rod(_sigma, y.reshape(4, k), u[1:]).ravel()

    start = np.zeros((4, k))
    start[3] = u[0]
    return (
        solve_ivp(rod, (0, 1), start.ravel(), method="DOP853", rtol=1e-10, atol=1e-11)
        .y[:, -1]
        .reshape(4, k)
    )


def inverse_by_integration(
    clamp: np.ndarray, axis: np.ndarray, force: np.ndarray, moment: np.ndarray
) -> np.ndarray:
    """Contact point from one sample's reactions: the rod's equation from the clamp (paper, eqs. 10
    to 16) up to κ = 0.

    SciPy's `solve_ivp`, DOP853, rtol 1e-9.
    """
    F, base = -force, np.linalg.norm(moment)
    side = np.cross(axis, moment) / base
    Q, N = F @ side, F @ axis

    def rod(_s: float, y: np.ndarray) -> list[float]:
        sine, cosine = np.sin(y[2]), np.cos(y[2])
        return [sine, cosine, y[3], N * sine - Q * cosine]

    def straight(_s: float, y: np.ndarray) -> float:
        return y[3]

    straight.terminal = True
    found = solve_ivp(
        rod, (0, 1.5), [0, 0, 0, base], method="DOP853", rtol=1e-9, atol=1e-12, events=straight
    )
    xi, zeta = found.y_events[0][0][:2]
    return clamp + xi * side + zeta * axis
