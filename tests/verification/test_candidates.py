"""Reactions that more than one contact on a curved rod explains."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import vibrissa as vb
from vibrissa.inverse.kernels import candidates_of
from vibrissa.inverse.shared import samples_of, setting_of, under_friction
from vibrissa.mechanics.kirchhoff import Kirchhoff, Push
from vibrissa.mechanics.model import AT_ORIGIN
from vibrissa.mechanics.models import spatial
from vibrissa.numerics.compiled import compiled

ROD = vb.Rod(length=1.0, bending_stiffness=1.0).curved(vb.RestShape.arc(radius=0.4))


def held_at(rod: Kirchhoff, force: np.ndarray, s: float) -> np.ndarray:
    """Where the point of a rod at an arc length comes to lie under a force on it (3,)."""
    push = jnp.asarray(force)

    def gap(reach: jax.Array) -> tuple[jax.Array, jax.Array]:
        line = rod.line(AT_ORIGIN, Push(push, jnp.cross(reach, push)))
        return (line.at(jnp.asarray(s))[0] - reach,) * 2

    slopes, reach = (
        compiled(jax.jacfwd(gap, has_aux=True), quick=True),
        rod.free(AT_ORIGIN).at(s)[0],
    )
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


def pushed(place: float, force: float, turn: float, taper: float) -> vb.Reactions:
    """Reactions to a force across a rod in the plane in which it is curved at rest, by integration
    from the contact back to the clamp (SciPy).
    """

    def slope(s: float, at: np.ndarray) -> list[float]:
        # The force −F along x has the moment F z about the rod at (x, z), seen from the contact.
        return [np.sin(at[2]), np.cos(at[2]), turn + force * at[1] / (1 - taper * s) ** 4]

    back = solve_ivp(slope, (place, 0), [0.0, 0, 0], method="DOP853", rtol=1e-12, atol=1e-13)
    x, z, angle = back.y[:, -1]
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    point, push = turned @ [-x, -z], turned @ [-force, 0]
    trail = vb.Trail(position=[[0.0, 0, 0]], orientation=[[0.0, 0, 0, 1]])
    moment = point[1] * push[0] - point[0] * push[1]
    return vb.Reactions(trail, [[-push[0], 0, -push[1]]], [[0, -moment, 0]])


def arc(turn: float, taper: float) -> vb.Rod:
    """A rod of length 1, bent to an arc at rest."""
    rod = vb.Rod.tapered(
        length=1.0,
        base_radius=0.01,
        tip_radius=0.01 * (1 - taper),
        youngs_modulus=4e8 / np.pi,
        poisson_ratio=0.3,
    )
    return rod.curved(vb.RestShape.polynomial((turn,)))


@pytest.mark.parametrize(
    ("place", "force", "turn", "taper"), [(0.232, 8.4, 0.0, 0.0), (0.213, 3.2, 0.0, 0.8)]
)
def test_only_crossings_are_candidates(
    place: float, force: float, turn: float, taper: float
) -> None:
    """The rod under the force turns until it is parallel to it, where it comes closest to the line
    of action without crossing it, and the force's moment falls again at the tip.
    """
    found = vb.reconstruct(arc(turn, taper), pushed(place, force, turn, taper))
    assert found.status[0] == vb.Status.OK and found.candidates == []
    np.testing.assert_allclose(found.arc_length, place, atol=1e-8)


def test_crossings_of_a_uniform_rod() -> None:
    """Between two crossings lies an arch of the rectangular elastica, 2 K(½) √(EI/F) long."""
    place, force = 0.2, 56.0
    found = vb.reconstruct(arc(0.0, 0.0), pushed(place, force, 0.0, 0.0))
    ((_, contacts),) = found.candidates
    later = place + 2 * ellipk(0.5) / np.sqrt(force)
    # The steps of the library, for so strong a force.
    np.testing.assert_allclose(contacts.arc_length, [place, later], atol=1e-6)


@pytest.mark.parametrize(
    ("place", "force", "turn", "taper"),
    [(0.95, -2.2, 210.0, 0.0), (0.25, 10.0, 90.0, 0.5), (0.9, -2.0, 180.0, 0.5)],
)
def test_outer_contacts_are_steeper_where_the_rod_gets_thinner(
    place: float, force: float, turn: float, taper: float
) -> None:
    """Along an arc m·B⁻¹m/2 + m·u + F·t is constant if the rod is uniform, and else grows as it
    gets thinner: so does the cosine between force and rod from one place without moment to the
    next, and without friction a whisker's contact is unique.
    """
    turn = np.radians(turn)
    reactions, rod = pushed(place, force, turn, taper), arc(turn, taper)
    setting = under_friction(setting_of(rod, reactions), None)
    contact, fits = candidates_of(setting, samples_of(rod, reactions))
    inner, outer = (2 * contact.incidence - 1)[fits]
    np.testing.assert_allclose(np.min(abs(contact.arc_length[fits] - place)), 0, atol=1e-7)
    if taper:
        assert outer > inner + 0.1
    else:
        np.testing.assert_allclose(outer, inner, atol=1e-9)
