"""Stability by energy: a discretised rod that may not enter the object goes downhill from a scan's shape, pushed a little out of its plane.

The rod is a chain of N segments of length h = 1/N with unit tangents t_i, t_0 the clamp's. Its bending energy, second order in h, is

    U = |t_1 − t_0|²/h + Σ |t_{i+1} − t_i|²/(2h),

and its nodes x_j = P0 + h Σ_{i≤j} t_i have to stay outside, g(x_j) ≥ 0, which the method of multipliers enforces (Nocedal and Wright, Numerical
Optimization, section 17.4). A minimum of U is a stable equilibrium; the multipliers are the contact force. Model units, L = EI = 1.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import minimize

import vibrissa as vb

SEGMENTS = 60
STIFFNESS, ROUNDS = 1e3, 8
PUSH = 0.05
CLOSE = 1e-2

# The paper's object: C = 0.5x² + y² + 0.4.
CURVATURES, HEIGHT = np.array([1.0, 2.0]), 0.4


class Rest(NamedTuple):
    """Where the chain comes to rest."""

    point: np.ndarray
    force: np.ndarray
    energy: float
    depth: float


def levels(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """g (N,) and ∇g (N, 3) at nodes (N, 3)."""
    value = 0.5 * np.sum(CURVATURES * nodes[:, :2] ** 2, axis=1) + HEIGHT - nodes[:, 2]
    return value, np.column_stack([CURVATURES * nodes[:, :2], -np.ones(len(nodes))])


def bending(tangents: np.ndarray) -> tuple[float, np.ndarray]:
    """U and ∂U/∂t_1…N (N, 3), given t_0…N (N + 1, 3)."""
    h = 1 / SEGMENTS
    turns = np.diff(tangents, axis=0)
    weight = np.full((SEGMENTS, 1), 1 / (2 * h))
    weight[0] = 1 / h
    pull = 2 * weight * turns
    gradient = pull.copy()
    gradient[:-1] -= pull[1:]
    return float(np.sum(weight * turns**2)), gradient


def tangents_of(w: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """t_0…N, and the norms of what they are normalised from: t_0 + √h Σ w, in which U is well conditioned."""
    u = axis + np.cumsum(w.reshape(SEGMENTS, 3), axis=0) / np.sqrt(SEGMENTS)
    norm = np.linalg.norm(u, axis=1, keepdims=True)
    return np.vstack([axis, u / norm]), norm


def downhill(w: np.ndarray, clamp: np.ndarray, axis: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
    """Minimise U + Σ max(0, λ − K g)²/(2K)."""

    def merit(w: np.ndarray) -> tuple[float, np.ndarray]:
        tangents, norm = tangents_of(w, axis)
        energy, slope = bending(tangents)
        value, gradient = levels(clamp + np.cumsum(tangents[1:], axis=0) / SEGMENTS)
        push = np.maximum(0, multipliers - STIFFNESS * value)
        slope -= np.cumsum((push[:, None] * gradient)[::-1], axis=0)[::-1] / SEGMENTS
        t = tangents[1:]
        across = (slope - t * np.sum(slope * t, axis=1, keepdims=True)) / norm
        return energy + push @ push / (2 * STIFFNESS), np.cumsum(across[::-1], axis=0)[::-1].ravel() / np.sqrt(SEGMENTS)

    return minimize(merit, w, jac=True, method="L-BFGS-B", options={"maxiter": 3000, "maxfun": 5000, "maxcor": 30, "ftol": 1e-15, "gtol": 1e-7}).x


def come_to_rest(scan: vb.Scan, index: int, push: float) -> Rest:
    """Let the chain go from a scan's shape, its tangents pushed out of the bending plane, most at the tip."""
    clamp, axis = scan.trail.position[index], scan.trail.axis[index]
    t = np.diff(scan.elastic_line(index, SEGMENTS + 1), axis=0)
    t += push / SEGMENTS * np.linspace(0, 1, SEGMENTS)[:, None] * scan.plane_normal[index]
    t = np.vstack([axis, t / np.linalg.norm(t, axis=1, keepdims=True)])
    w, multipliers = (np.diff(t, axis=0) * np.sqrt(SEGMENTS)).ravel(), np.zeros(SEGMENTS)
    for _ in range(ROUNDS):
        w = downhill(w, clamp, axis, multipliers)
        tangents, _norm = tangents_of(w, axis)
        nodes = clamp + np.cumsum(tangents[1:], axis=0) / SEGMENTS
        value, gradient = levels(nodes)
        multipliers = np.maximum(0, multipliers - STIFFNESS * value)
    point = multipliers @ nodes / multipliers.sum()
    return Rest(point, multipliers @ gradient, bending(tangents)[0], float(-value.min()))


def scan_at(y0: float, x0: float) -> tuple[vb.Scan, int]:
    x = np.append(np.arange(1.2, x0 + 1e-9, -0.02), x0)
    scan = vb.scan(vb.Rod.unit(), vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4), vb.Trail(np.column_stack([x, np.full_like(x, y0), np.zeros_like(x)])))
    return scan, len(x) - 1
