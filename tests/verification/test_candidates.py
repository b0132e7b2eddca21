"""Reactions that more than one contact on a curved rod explains."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrissa as vb
from vibrissa.mechanics.kirchhoff import Kirchhoff, Push
from vibrissa.mechanics.model import AT_ORIGIN
from vibrissa.mechanics.models import spatial

ROD = vb.Rod(length=1.0, bending_stiffness=1.0).curved(vb.RestShape.arc(radius=0.4))


def held_at(rod: Kirchhoff, force: np.ndarray, s: float) -> np.ndarray:
    """Where the point of a rod at an arc length comes to lie under a force on it (3,)."""
    push = jnp.asarray(force)

    def gap(reach: jax.Array) -> tuple[jax.Array, jax.Array]:
        line = rod.line(AT_ORIGIN, Push(push, jnp.cross(reach, push)))
        return (line.at(jnp.asarray(s))[0] - reach,) * 2

    slopes, reach = jax.jit(jax.jacfwd(gap, has_aux=True)), rod.free(AT_ORIGIN).at(s)[0]
    for _ in range(8):
        slope, off = slopes(reach)
        reach = reach - jnp.linalg.solve(slope, off)
    return np.asarray(reach)


@pytest.fixture(scope="module")
def hooked() -> tuple[vb.Reactions, np.ndarray]:
    """A hook of 143° pushed at its tip by a force whose line of action also crosses its stem, and
    the tip.
    """
    rod = spatial(ROD, 24)
    free = rod.free(AT_ORIGIN)
    tip, stem = (np.asarray(free.at(jnp.asarray(s))[0]) for s in (1.0, 0.1))
    force = 0.2 * (stem - tip) / np.linalg.norm(stem - tip)
    reach = held_at(rod, force, 1.0)
    trail = vb.Trail(position=[[0.0, 0, 0]], orientation=[[0.0, 0, 0, 1]])
    return vb.Reactions(trail, -force[None], -np.cross(reach, force)[None]), reach


def test_all_contacts_are_listed(hooked: tuple[vb.Reactions, np.ndarray]) -> None:
    """The row says so, and the true contact is among them; each lies on the line of the force."""
    reactions, tip = hooked
    found = vb.reconstruct(ROD, reactions)
    assert found.status[0] == vb.Status.NOT_UNIQUE
    ((row, contacts),) = found.candidates
    assert row == (0,) and len(contacts.point) == 2
    np.testing.assert_allclose(contacts.point[-1], tip, atol=1e-8)
    np.testing.assert_allclose(contacts.arc_length[-1], 1.0, atol=1e-8)
    np.testing.assert_allclose(
        np.cross(contacts.point, -reactions.force[0]), -np.repeat(reactions.moment, 2, 0), atol=1e-9
    )


def test_friction_may_tell_them_apart(hooked: tuple[vb.Reactions, np.ndarray]) -> None:
    """Without friction the stem would have to be perpendicular to the force; the tip need not."""
    reactions, tip = hooked
    found = vb.reconstruct(ROD, reactions, friction=0.0)
    assert found.status[0] == vb.Status.OK and found.candidates == []
    np.testing.assert_allclose(found.point[0], tip, atol=1e-8)
