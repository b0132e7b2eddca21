"""L. A. Huet, J. W. Rudnicki, M. J. Z. Hartmann, Tactile sensing with whiskers of various shapes:
determining the three-dimensional location of object contact based on mechanical signals at the
whisker base, Soft Robotics 4 (2017) 88-102, table 1: the contact points of their chains of rigid
links are off those of finite elements by 0.11 % of the arc length for a cylinder, 0.076 % for a taper
and 0.087 % for a taper with curvature. Here the contact found from the signals at the base is off by
less than a millionth.

Lengths follow from the errors that they print in µm and in per cent. Radii and stiffness are those of
rat whiskers in general.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import vibrissa as vb

ALLOWED = 1e-6
"""Of the arc length: a thousandth of the errors printed."""
MATERIAL = {"youngs_modulus": 3.34e9, "poisson_ratio": 0.38}
CYLINDER = vb.Rod.cylinder(length=0.035, radius=1e-4, **MATERIAL)
TAPER = vb.Rod.tapered(length=0.035, base_radius=1e-4, tip_radius=1e-4 / 15, **MATERIAL)
CURVED = vb.rods.rat_whisker(row="B", column=0)
WHISKERS = {
    "cylinder": (CYLINDER.curved(vb.RestShape.polynomial((0.0,))), 0.0227, 1e-4),
    "taper": (TAPER, 0.0227, 1e-4),
    "taper and curvature": (CURVED, 0.0345, 4e-4),
}
"""The rod, and their place [m] and force [N]; the cylinder goes the way of all other rods."""


class Felt(NamedTuple):
    """What a clamp at the origin with its axes along the world's feels, and where the contact is."""

    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray


def felt(rod: vb.Rod, place: float, force: float, angle: float) -> Felt:
    """A force across the rod at an arc length, at an angle about it. Back from the contact, where
    there is no moment, to the clamp: an initial value problem in rotation matrices.
    """
    stiffness, parabola = rod.bending_stiffness, rod.rest
    push = force * np.array([np.cos(angle), np.sin(angle), 0.0])

    def slope(s: float, y: np.ndarray) -> np.ndarray:
        r, axes = y[:3], y[3:].reshape(3, 3)
        # Of the part between here and the contact, which is the origin of these axes.
        own = axes.T @ np.cross(-r, push)
        thick = 1.0
        if rod.section is not None:
            base, tip = rod.section.radius
            thick = (base + (tip - base) * s / rod.length) ** 4
        spin = own * [1, 1, 1 + rod.poisson_ratio] / (stiffness * thick) + bend(s)
        cross = np.array([[0, -spin[2], spin[1]], [spin[2], 0, -spin[0]], [-spin[1], spin[0], 0]])
        return np.concatenate([axes[:, 2], (axes @ cross).ravel()])

    def bend(s: float) -> np.ndarray:
        """Curvature of y = a x² at an arc length, by Newton's method for x."""
        a = getattr(parabola, "a", 0.0)
        x = s
        for _ in range(20 if a else 0):
            v = 2 * a * x
            x -= ((v * np.hypot(1, v) + np.arcsinh(v)) / (4 * a) - s) / np.hypot(1, v)
        return np.array([0.0, 2 * a / (1 + (2 * a * x) ** 2) ** 1.5, 0.0])

    start = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    end = solve_ivp(slope, (place, 0.0), start, "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    reach, turn = -end[:3], Rotation.from_matrix(end[3:].reshape(3, 3)).inv()
    point, push = turn.apply(reach), turn.apply(push)
    return Felt(-push, -np.cross(point, push), point)


def sampled(
    shape: str, strengths: tuple[float, ...]
) -> tuple[vb.Rod, vb.Reactions, np.ndarray, list[float]]:
    """A whisker, what it feels at three places and from all sides, and where."""
    rod, place, force = WHISKERS[shape]
    states, places = [], []
    for s in (0.4 * rod.length, place, 0.9 * rod.length):
        # A force that bends alike where the whisker is thin.
        soft = float(rod.bending_at(s / rod.length)) ** 0.75
        here = float(rod.bending_at(place / rod.length)) ** 0.75
        for strength in strengths:
            for angle in np.radians([0, 70, 160, 250]):
                states.append(felt(rod, s, strength * force * soft / here, angle))
                places.append(s)
    measured, moments, points = map(np.array, zip(*states, strict=True))
    trail = vb.Trail(np.zeros((len(states), 3)))
    return rod, vb.Reactions(trail, measured, moments), points, places


@pytest.mark.parametrize("shape", WHISKERS)
@pytest.mark.parametrize(("strengths", "accuracy"), [((0.3, 1.0), 1e-10), ((2.0,), 1e-12)])
def test_contacts_are_found_to_a_millionth_of_the_arc_length(
    shape: str, strengths: tuple[float, ...], accuracy: float
) -> None:
    """At the printed place and elsewhere along the whisker, under the printed force and stronger
    ones, from all sides.
    """
    rod, felt_ones, points, places = sampled(shape, strengths)
    found = vb.reconstruct(rod, felt_ones, accuracy=accuracy)
    listed = {one.row[0]: one.contacts.point for one in found.candidates}
    for row, (point, status) in enumerate(zip(found.point, found.status, strict=True)):
        assert status == (vb.Status.NOT_UNIQUE if row in listed else vb.Status.OK)
        off = [np.linalg.norm(at - points[row]) for at in listed.get(row, [point])]
        assert min(off) < ALLOWED * rod.length
    unique = found.status == vb.Status.OK
    assert np.all(unique) == (shape != "taper and curvature") and np.mean(unique) > 0.3
    off = abs(found.arc_length - places)[unique]
    assert off.max() < ALLOWED * rod.length


def test_a_contact_behind_more_than_a_full_turn_is_not_another_one() -> None:
    """Three times the printed force rolls the whisker up. No contact before that explains what is
    felt then, also where force and moment are nearly perpendicular.
    """
    rod, felt_ones, points, places = sampled("taper and curvature", (3.0,))
    near = np.array(places) < 0.5 * rod.length
    found = vb.reconstruct(rod, felt_ones)
    off = np.linalg.norm(found.point - points, axis=1)[near & (found.status == vb.Status.OK)]
    assert off.max(initial=0.0) < ALLOWED * rod.length
    assert (abs(found.single_contact_residual) < 1e-3)[near].any()


@pytest.mark.parametrize("shape", WHISKERS)
@pytest.mark.parametrize("accuracy", [1e-4, 1e-7])
def test_contacts_of_few_steps_are_as_good_or_say_that_they_are_not(
    shape: str, accuracy: float
) -> None:
    """Six steps and nine leave up to 2e-2 of the arc length."""
    rod, felt_ones, points, _ = sampled(shape, (0.3, 1.0, 2.0))
    found = vb.reconstruct(rod, felt_ones, accuracy=accuracy)
    fine = found.status == vb.Status.OK
    off = np.linalg.norm(found.point - points, axis=1)[fine]
    assert off.max(initial=0.0) < ALLOWED * rod.length
    assert shape == "taper and curvature" or fine.all()
