"""That the search for equilibria finds all of them, each once: two routes against each other, a
symmetric pose against one that is nearly so, and the order by potential.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.forward.equilibria import Equilibrium
from vibrissa.surfaces import Surface

RADIUS = 0.01
STEEL = {"length": 1.0, "youngs_modulus": 4 / (np.pi * RADIUS**4), "density": 400.0}
"""EI = 1, and a weight of 1.2 EI/L²."""


def tapered(share: float) -> vb.Rod:
    """A rod whose tip is thinner by a share."""
    return vb.Rod.tapered(base_radius=RADIUS, tip_radius=RADIUS * (1 - share), **STEEL)


class Case(NamedTuple):
    """An object before a clamp at the origin."""

    surface: Surface
    finite_radius: bool = False


def cases() -> dict[str, Case]:
    """Each kind of object at a random place."""
    random = np.random.default_rng(1)
    turn, center = Rotation.random(rng=random), np.array([0.25, 0.1, 0.7])
    ball = vb.surfaces.Sphere(center=(0, 0, 0), radius=0.25)
    egg = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.2, 0.35, 0.25))
    box = vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.2, 0.3, 0.15))
    plane = vb.surfaces.Plane((0, 0, 0), (-0.5, -0.3, -0.7))
    return {
        "ball": Case(ball.placed(translation=(0.1, -0.2, 0.55))),
        "ellipsoid": Case(egg.placed(turn, center)),
        "box": Case(box.placed(turn, center), finite_radius=True),
        "plane": Case(plane.placed(translation=(0.2, 0.1, 0.5))),
    }


@pytest.mark.parametrize(
    "name",
    ["ball", "plane", *(pytest.param(n, marks=pytest.mark.slow) for n in ("ellipsoid", "box"))],
)
def test_a_rod_without_a_closed_form_has_those_of_one_with_it(name: str) -> None:
    """A rod that is hardly tapered is integrated; it has the same equilibria as the uniform one, and
    at sharp edges it may lead to more.
    """
    surface, finite_radius = cases()[name]
    plain, integrated = (
        vb.equilibria(rod, surface, position=(0, 0, 0), finite_radius=finite_radius)
        for rod in (vb.Rod.cylinder(radius=RADIUS, **STEEL), tapered(1e-9))
    )
    assert len(plain) >= 5
    assert name == "box" or len(integrated) == len(plain)
    for one in plain:
        other = min(integrated, key=lambda each: abs(each.energy - one.energy))
        np.testing.assert_allclose(other.point, one.point, rtol=0, atol=1e-6)
        np.testing.assert_allclose(other.reactions.force, one.reactions.force, rtol=1e-5, atol=1e-5)
        assert other.energy == pytest.approx(one.energy, rel=1e-6)
        assert other.second_variation == pytest.approx(one.second_variation, rel=1e-3, abs=1e-3)
        assert (other.kind, other.inflections) == (one.kind, one.inflections)


BALL = vb.surfaces.Sphere(center=(0, 0, 0.9), radius=0.3)
FACE = vb.surfaces.Plane((0, 0, 0.7), (0, 0, -1))


def at(rod: vb.Rod, surface: Surface, turn: Rotation, tilt: float = 0.0) -> list[Equilibrium]:
    """Those of a clamp whose axis is that of a body of revolution, or tilted away from it."""
    lean = turn * Rotation.from_rotvec([tilt, 0, 0])
    return vb.equilibria(rod, surface.placed(turn), position=(0, 0, 0), orientation=lean)


@pytest.mark.parametrize("taper", [0.0, 0.5])
@pytest.mark.parametrize("surface", [BALL, FACE], ids=["ball", "face"])
def test_one_of_each_circle(surface: Surface, taper: float) -> None:
    """Of each there are two once the clamp is tilted, one to either side in the plane of tilting; if
    the circle is stable, one of them is.
    """
    rod = tapered(taper) if taper else vb.Rod.cylinder(radius=RADIUS, **STEEL)
    turn = Rotation.from_rotvec([0.3, -0.8, 1.1])
    circles, pairs = at(rod, surface, turn), at(rod, surface, turn, 1e-3)
    assert [one.inflections for one in circles] == [0, 1, 2]
    assert [one.stable for one in circles] == [True, False, False]
    for one in circles:
        x, y, _ = turn.inv().apply(one.point)
        assert x > 0
        assert y == pytest.approx(0, abs=1e-9)
        pair = [other for other in pairs if other.inflections == one.inflections]
        assert len(pair) == 2
        assert np.mean([other.energy for other in pair]) == pytest.approx(one.energy, rel=1e-3)
        sides = [turn.inv().apply(other.point) for other in pair]
        assert sorted(np.sign(y) for _, y, _ in sides) == [-1, 1]
        np.testing.assert_allclose([abs(x) for x, _, _ in sides], 0, atol=1e-9)
        assert sum(other.stable for other in pair) == one.stable


def test_circles_are_about_the_clamp_s_axis_only() -> None:
    """Beside that axis the ball leaves pairs in the plane of its centre, and both are listed."""
    aside = vb.surfaces.Sphere(center=(0.05, 0, 0.9), radius=0.3)
    found = at(tapered(0.5), aside, Rotation.identity())
    assert all(abs(one.point[1]) < 1e-9 for one in found)
    assert {np.sign(one.point[0] - 0.05) for one in found if one.inflections == 0} == {-1, 1}


def potential(one: Equilibrium, rod: vb.Rod) -> float:
    """Of bending, and of the weight from the shape alone."""
    weight = rod.linear_density * 9.81
    return one.energy + weight * rod.length * float(
        np.trapezoid(one.elastic_line[:, 2], dx=1 / 400)
    )


def test_the_first_has_the_lowest_potential() -> None:
    """A heavy rod over a ball: reaching further round it, it is bent more, but lies lower."""
    steel = STEEL | {"density": 1000.0}
    rod = vb.Rod.cylinder(radius=RADIUS, **steel).loaded(vb.Loads(gravity=(0, 0, -9.81)))
    ball = vb.surfaces.Sphere(center=(0.72, 0.06, 0.01), radius=0.16)
    found = vb.equilibria(
        rod, ball, position=(0, 0, 0), orientation=Rotation.from_rotvec([0, -0.19, 0])
    )
    order, energies = [potential(one, rod) for one in found], [one.energy for one in found]
    assert order == sorted(order)
    assert energies != sorted(energies)
