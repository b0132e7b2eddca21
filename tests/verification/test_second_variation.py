"""Whether an equilibrium is stable, by a chain: the signs of the second variation are those of a
Hessian that knows no rod, plane or curve.

The chain has N segments of length h = 1/N with unit tangents tᵢ, t₀ the clamp's, nodes xⱼ = P0 + h
Σ_{i≤j} tᵢ and, of second order in h, the energy

    U = |t₁ − t₀|²/h + Σ |tᵢ₊₁ − tᵢ|²/(2h).

It touches by one number, c = 0: in tip contact the level g of its end; else the vertex of the
parabola through the levels of three nodes, so that the contact may wander along the chain as it may
over the object. Newton's method finds the stationary point of U − λ c next to an equilibrium. That
is stable where the Hessian of U − λ c is positive on the changes that keep c, to first order, zero
(Nocedal and Wright, Numerical Optimization, theorems 12.5 and 12.6). Model units.

No chain is let go: a stable state can have a barrier about it that is lower than a push, here of
0.003 EI/L.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from scipy.linalg import eigh

import vibrissa as vb
from vibrissa.forward.equilibria import Equilibrium
from vibrissa.numerics.compiled import compiled

SEGMENTS, PLACES = 80, (0.6, 0.0)


class Chain(NamedTuple):
    """A chain's stationary point next to an equilibrium."""

    point: np.ndarray
    force: float
    energy: float
    least: float
    """Eigenvalue of the Hessian, where contact is kept, per ∫ |δt|² ds up to the contact."""


def frames(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors square to each tangent and to each other."""
    first = np.cross(t, np.eye(3)[np.argmin(np.abs(t), axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(t, first)


@jax.jit
def parts(
    q: Array, t: Array, frame: tuple[Array, Array], clamp: Array, touching: Array
) -> tuple[Array, Array, Array]:
    """U, c and the touching point, of changes q (2N,) of the tangents t; `touching` is the middle
    node, or the last for the tip.
    """
    a, b = q.reshape(2, -1, 1)
    u = t + a * frame[0] + b * frame[1]
    u = u / jnp.sqrt(jnp.sum(u * u, axis=1, keepdims=True))
    count = len(u)
    axis = jnp.array([[0.0, 0.0, 1.0]])
    turns = jnp.sum(jnp.diff(jnp.concatenate([axis, u]), axis=0) ** 2, axis=1) * count / 2
    nodes = clamp + jnp.tri(count + 1, count, -1) @ u / count
    # The paper's object: C = 0.5x² + y² + 0.4.
    level = 0.5 * nodes[:, 0] ** 2 + nodes[:, 1] ** 2 + 0.4 - nodes[:, 2]
    middle = jnp.minimum(touching, count - 1)
    before, here, after = level[middle - 1], level[middle], level[middle + 1]
    share = (before - after) / (2 * (before - 2 * here + after))
    vertex = here + share * (after - before) / 4
    wanders = nodes[middle] + share * (nodes[middle + 1] - nodes[middle - 1]) / 2
    tip = touching == count
    return (
        jnp.sum(turns) + turns[0],
        jnp.where(tip, level[-1], vertex),
        jnp.where(tip, nodes[-1], wanders),
    )


@partial(compiled, quick=True)
def linearised(y: Array, *shape: Array) -> tuple[Array, Array]:
    """Gradient of U − λ c by y = (q, λ), and its Hessian."""

    def lagrangian(y: Array) -> Array:
        energy, contact, _ = parts(y[:-1], *shape)
        return energy - y[-1] * contact

    return jax.grad(lagrangian)(y), jax.hessian(lagrangian)(y)


def chain_at(one: Equilibrium, x0: float) -> Chain:
    """The chain at an equilibrium, settled."""
    line = one.elastic_line[:: (len(one.elastic_line) - 1) // SEGMENTS]
    t = np.diff(line, axis=0)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    touching = SEGMENTS if one.kind == vb.ContactKind.TIP else round(one.arc_length * SEGMENTS)
    shape = (
        jnp.asarray(t),
        tuple(map(jnp.asarray, frames(t))),
        jnp.array([x0, 0.2, 0.0]),
        jnp.asarray(touching),
    )
    steepness = np.linalg.norm([one.point[0], 2 * one.point[1], 1])
    y = np.append(np.zeros(2 * SEGMENTS), np.linalg.norm(one.reactions.force) / steepness)
    gradient, hessian = (np.asarray(part) for part in linearised(jnp.asarray(y), *shape))
    while np.abs(gradient).max() > 1e-11:
        y = y - np.linalg.solve(hessian, gradient)
        gradient, hessian = (np.asarray(part) for part in linearised(jnp.asarray(y), *shape))
    basis = np.linalg.svd(hessian[-1:, :-1])[2][1:].T
    # Beyond the contact next to nothing, so that the rest of the chain follows.
    weight = (
        np.tile(np.clip(one.arc_length * SEGMENTS - np.arange(SEGMENTS), 1e-6, 1), 2) / SEGMENTS
    )
    energy, _, point = parts(jnp.asarray(y[:-1]), *shape)
    steepness = np.linalg.norm([point[0], 2 * point[1], 1])
    least = eigh(
        basis.T @ hessian[:-1, :-1] @ basis,
        basis.T @ (weight[:, None] * basis),
        eigvals_only=True,
        subset_by_index=[0, 0],
    )
    return Chain(np.asarray(point), float(y[-1] * steepness), float(energy), float(least[0]))


@pytest.fixture(scope="module")
def found() -> list[tuple[Equilibrium, Chain]]:
    surface = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
    both = []
    for x0 in PLACES:
        for one in vb.equilibria(vb.Rod.unit(), surface, position=(x0, 0.2, 0)):
            both.append((one, chain_at(one, x0)))
    return both


def test_the_chain_is_in_equilibrium_at_the_same_place(
    found: list[tuple[Equilibrium, Chain]],
) -> None:
    """But for errors of second order in the segments' length, f h²."""
    assert len(found) >= 12
    for one, chain in found:
        force = np.linalg.norm(one.reactions.force)
        off = max(2e-3, force / SEGMENTS**2)
        np.testing.assert_allclose(chain.point, one.point, rtol=0, atol=5e-4)
        assert chain.force == pytest.approx(force, rel=off)
        assert chain.energy == pytest.approx(one.energy, rel=off)


def test_what_is_called_stable_is_and_what_is_called_unstable_is_not(
    found: list[tuple[Equilibrium, Chain]],
) -> None:
    for one, chain in found:
        assert one.stable == (chain.least > 0)
        assert one.second_variation == pytest.approx(chain.least, rel=1e-2, abs=3e-3)
    # Of both kinds of contact, and two at one place, of which the higher holds the less.
    assert {one.kind for one, _ in found if one.stable} == {
        vb.ContactKind.TIP,
        vb.ContactKind.TANGENTIAL,
    }
    assert {one.kind for one, _ in found if not one.stable} == {
        vb.ContactKind.TIP,
        vb.ContactKind.TANGENTIAL,
    }
    stable = [one for one, _ in found if one.stable and one.point[0] == pytest.approx(0, abs=1e-9)]
    assert len(stable) == 2
    assert stable[1].second_variation < 0.1 * stable[0].second_variation
