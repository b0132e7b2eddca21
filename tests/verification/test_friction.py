"""Friction, forward: Coulomb's law seen from outside, work, convergence, and shooting in space with
a law of its own.
"""

from collections.abc import Callable

import numpy as np
import pytest
import shooting
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

import vibrissa as vb

UNIT = vb.Rod.unit()
PARABOLOID = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
LEVEL = shooting.paraboloid(0.5, 1.0, 0.4)
FRICTION = 0.3

# Way-points of the clamp and steps between them: in, back by little, on beside the way, back, out.
# Where the trail turns the contact sticks, or rolls.
PLACES = [
    (1.2, 0.2, 0.0),
    (0.5, 0.2, 0.0),
    (0.502, 0.2, 0.0),
    (0.62, 0.2, 0.0),
    (-0.2, 0.25, 0.0),
    (-0.19, 0.25, 0.0),
    (0.1, 0.2, 0.0),
    (-0.6, 0.2, 0.0),
]
STEPS = [35, 4, 10, 41, 8, 16, 35]


def turning_trail(finer: int) -> vb.Trail:
    """The way-points joined by straight lines, each step divided by `finer`."""
    parts = [
        np.linspace(a, b, finer * n, endpoint=False)
        for a, b, n in zip(PLACES, PLACES[1:], STEPS, strict=False)
    ]
    return vb.Trail(np.concatenate([*parts, PLACES[-1:]]))


def line(
    friction: float,
    start: tuple[float, ...] = (1.2, 0.2, 0.0),
    stop: tuple[float, ...] = (-1.2, 0.2, 0.0),
) -> vb.Scan:
    return vb.scan(
        UNIT, PARABOLOID, vb.Trail.line(start=start, stop=stop, count=241), friction=friction
    )


@pytest.fixture(scope="module")
def turning() -> dict[int, vb.Scan]:
    return {
        finer: vb.scan(UNIT, PARABOLOID, turning_trail(finer), friction=FRICTION)
        for finer in (1, 2, 4, 8, 32)
    }


def tangential_parts(scan: vb.Scan, level: shooting.Level) -> tuple[np.ndarray, np.ndarray]:
    """Of the contact forces that the clamp feels: tangential over normal part (k, 3), and normal
    part (k,), by the level's own gradient.
    """
    rows = scan.in_contact
    n = np.array([level.normal(p) for p in scan.point[rows]])
    force = -scan.reactions.force[rows]
    normal = np.sum(force * n, axis=1)
    return (force - normal[:, None] * n) / normal[:, None], normal


def material_steps(scan: vb.Scan) -> np.ndarray:
    """Path of the rod's touching point over the object between positions (n − 1, 3): dP₁ − t ds₁, t
    the mean of both ends.
    """
    moved = np.diff(scan.point, axis=0)
    s = np.diff(scan.arc_length)
    return moved - (scan.contact_tangent[1:] + scan.contact_tangent[:-1]) / 2 * s[:, None]


def test_without_a_coefficient_it_is_the_frictionless_law() -> None:
    """Forces and points differ from those without friction by a first power of μ, down to rounding;
    events come where they came.
    """
    smooth = line(0.0)
    difference = []
    for friction in (1e-4, 1e-6, 1e-8):
        rough = line(friction)
        np.testing.assert_array_equal(rough.kind, smooth.kind)
        assert [event.kind for event in rough.events] == [event.kind for event in smooth.events]
        difference.append(
            [
                np.nanmax(np.abs(rough.point - smooth.point)),
                np.abs(rough.reactions.force - smooth.reactions.force).max(),
            ]
        )
    ratios = np.array(difference[:-1]) / difference[1:]
    np.testing.assert_allclose(ratios, 100, rtol=1e-3)
    assert np.max(difference[-1]) < 5e-8


def test_the_force_lies_in_the_cone_and_on_it_where_the_rod_slides(
    turning: dict[int, vb.Scan],
) -> None:
    scan = turning[32]
    assert {vb.Motion(value).name for value in np.unique(scan.motion)} == {
        "NONE",
        "STICK",
        "SLIP",
        "ROLL",
    }
    assert np.all(scan.status == vb.Status.OK)
    tau, normal = tangential_parts(scan, LEVEL)
    motion = scan.motion[scan.in_contact]
    size = np.linalg.norm(tau, axis=1)
    slips = motion == vb.Motion.SLIP
    assert np.all(normal > 0)
    np.testing.assert_allclose(size[slips], FRICTION, rtol=1e-9)
    assert np.all(size[~slips] <= FRICTION * (1 + 1e-9))
    assert np.min(size[~slips]) < 0.5 * FRICTION


def test_the_force_leans_against_the_sliding(turning: dict[int, vb.Scan]) -> None:
    scan = turning[8]
    slides = np.flatnonzero((scan.motion[1:] == vb.Motion.SLIP) & scan.in_contact[:-1]) + 1
    w = material_steps(scan)[slides - 1]
    tau = -scan.reactions.force[slides] / np.linalg.norm(
        scan.reactions.force[slides], axis=1, keepdims=True
    )
    n = np.array([LEVEL.normal(p) for p in scan.point[slides]])
    tau, w = (v - np.sum(v * n, axis=1, keepdims=True) * n for v in (tau, w))
    cosine = np.sum(tau * w, axis=1) / np.linalg.norm(tau, axis=1) / np.linalg.norm(w, axis=1)
    np.testing.assert_allclose(cosine, -1, atol=1e-9)


def test_a_contact_at_rest_keeps_its_place_and_a_rolling_one_moves_alike_on_both(
    turning: dict[int, vb.Scan],
) -> None:
    scan = turning[32]
    w, moved = (
        np.linalg.norm(material_steps(scan), axis=1),
        np.linalg.norm(np.diff(scan.point, axis=0), axis=1),
    )
    motion, wanders = scan.motion[1:], np.abs(np.diff(scan.arc_length))
    sticks, rolls = motion == vb.Motion.STICK, motion == vb.Motion.ROLL
    assert np.count_nonzero(sticks) > 5
    assert np.count_nonzero(rolls) > 50
    assert np.max(moved[sticks]) < 1e-9
    # The step's normal part is the curvature's, of second order.
    assert np.max(w[rolls] / moved[rolls]) < 1e-3
    np.testing.assert_allclose(wanders[rolls], moved[rolls], rtol=1e-3)
    assert np.median(wanders[rolls]) > 1e-5


def test_halved_steps_converge_with_first_order(turning: dict[int, vb.Scan]) -> None:
    """Through sliding, sticking, rolling and both kinds of contact."""
    finest = turning[32]
    errors = []
    for finer in (1, 2, 4, 8):
        scan = turning[finer]
        force, point = (part[::finer] for part in (scan.reactions.force, scan.point))
        force, point = force - finest.reactions.force[::32], point - finest.point[::32]
        rows = np.isfinite(point[:, 0])
        errors.append([np.sqrt(np.mean(force**2)), np.sqrt(np.mean(point[rows] ** 2))])
    slope = np.polyfit(np.log2([1, 2, 4, 8]), np.log2(errors), 1)[0]
    assert np.all(slope <= -1)
    assert np.max(errors[-1]) < 3e-3


def test_the_clamp_s_work_is_energy_and_heat(turning: dict[int, vb.Scan]) -> None:
    """Step by step to third order in its length; and heat is never gained."""
    off = []
    for finer in (4, 8, 32):
        scan = turning[finer]
        steps = np.flatnonzero(np.isfinite(scan.friction_work))
        assert np.all(scan.in_contact[steps] & scan.in_contact[steps - 1])
        heat = scan.friction_work[steps]
        gained = scan.energy[steps] - scan.energy[steps - 1]
        off.append(abs(np.sum(scan.clamp_work[steps] - gained - heat)))
        assert np.sum(heat) > 0.5
        assert np.min(heat) > -1e-7
    assert off[0] < 1e-5
    assert off[-1] < 1e-6


@pytest.mark.parametrize("share", np.linspace(0.12, 0.95, 7))
def test_the_elastic_line_is_that_of_a_rod_in_space_under_the_reported_force(
    turning: dict[int, vb.Scan], share: float
) -> None:
    """From the clamp, with the support reactions as initial values: the moment ends at s₁, at the
    contact, and all points lie on the line.
    """
    scan = turning[4]
    rows = np.flatnonzero(scan.in_contact)
    i = int(rows[int(share * len(rows))])
    t0 = shooting.clamp_tangent(scan.trail.orientation[i])
    s = np.linspace(0, 1, 200)
    s1 = scan.arc_length[i]
    force, moment = -scan.reactions.force[i], -scan.reactions.moment[i]
    bent = shooting.rod_along(scan.trail.position[i], t0, moment, force, np.append(s[s < s1], s1))
    np.testing.assert_allclose(bent[-1, :3], scan.point[i], rtol=0, atol=1e-9)
    np.testing.assert_allclose(bent[-1, 6:9], 0, atol=1e-9)
    assert bent[-1, 9] == pytest.approx(scan.energy[i], abs=1e-9)
    shape = scan.elastic_line(i, 200)
    np.testing.assert_allclose(shape[s < s1], bent[:-1, :3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        shape[s >= s1], bent[-1, :3] + (s[s >= s1] - s1)[:, None] * bent[-1, 3:6], rtol=0, atol=1e-9
    )
    away = bent[-1, 3:6] @ LEVEL.normal(scan.point[i])
    assert away < 0 if scan.kind[i] == vb.ContactKind.TIP else away == pytest.approx(0, abs=1e-9)


def shot_with_friction(clamps: np.ndarray, first: np.ndarray, softness: float) -> list[np.ndarray]:
    """States m(0), f, p (7,) of the rod's tip along clamps (n, 3), from its place `first` at first
    contact, by shooting in space.

    The law is −μ w/√(w² + ε²): without a cone, a corner or a projection. In tip contact w is the
    way of the tip.
    """
    t0 = np.array([0.0, 0.0, 1.0])
    found, point = [np.array([0.0, 0.0, 0.0, 0.0, *first])], first
    start = next(
        state for state in shooting.follow(LEVEL, clamps[:1], t0[None]) if state is not None
    )
    guess = start.unknowns[:7]
    for clamp in clamps:

        def off(u: np.ndarray, clamp: np.ndarray = clamp, point: np.ndarray = point) -> np.ndarray:
            n = LEVEL.normal(u[4:7])
            w = u[4:7] - point
            w = w - (w @ n) * n
            leaning = n - FRICTION * w / np.sqrt(w @ w + softness**2)
            end = shooting.rod_along(
                clamp, t0, u[:3], u[3] * leaning / np.linalg.norm(leaning), [1.0]
            )[-1]
            return np.concatenate([end[:3] - u[4:7], end[6:9], [LEVEL.value(u[4:7])]])

        state = fsolve(off, guess, xtol=1e-10, maxfev=400)
        assert np.abs(off(state)).max() < 1e-9
        found.append(state)
        # A guess at rest would sit on the corner that the law nearly has.
        guess, point = 2 * state - found[-2], state[4:7]
    return found[1:]


def test_shooting_with_a_soft_law_of_friction_goes_the_same_way() -> None:
    """From first contact on, in tip contact: the softened law tends to Coulomb's where the rod
    slides.
    """
    clamps = np.linspace((1.06, 0.2, 0.0), (0.62, 0.2, 0.0), 12)
    scan = vb.scan(UNIT, PARABOLOID, vb.Trail(clamps), friction=FRICTION)
    touching = np.array([np.sqrt(2 * (0.6 - 0.04)), 0.2, 1.0])
    states = shot_with_friction(clamps[1:], touching, 1e-7)
    assert set(scan.motion[1:]) == {vb.Motion.SLIP}
    for i, state in enumerate(states, start=1):
        np.testing.assert_allclose(scan.point[i], state[4:7], rtol=0, atol=1e-6)
        np.testing.assert_allclose(-scan.reactions.moment[i], state[:3], rtol=0, atol=1e-5)
        assert np.linalg.norm(scan.reactions.force[i]) == pytest.approx(state[3], abs=1e-5)


def test_mirrored_trails_give_mirrored_scans() -> None:
    mirror = np.array([1.0, -1.0, 1.0])
    one, other = (
        line(FRICTION, (1.2, 0.2, 0.0), (-1.2, 0.3, 0.0)),
        line(FRICTION, (1.2, -0.2, 0.0), (-1.2, -0.3, 0.0)),
    )
    for name in ("point", "force_direction", "normal", "contact_tangent"):
        np.testing.assert_allclose(
            getattr(other, name), getattr(one, name) * mirror, rtol=0, atol=1e-9
        )
    np.testing.assert_array_equal(other.motion, one.motion)
    np.testing.assert_allclose(other.friction_work, one.friction_work, rtol=0, atol=1e-9)


def test_turned_and_moved_scenes_give_turned_and_moved_scans(turning: dict[int, vb.Scan]) -> None:
    turn, shift = Rotation.from_rotvec([0.7, -0.4, 1.1]), np.array([0.3, -2.0, 0.7])
    here = turning[2]
    trail = vb.Trail(turn.apply(here.trail.position) + shift, turn.as_quat())
    there = vb.scan(UNIT, PARABOLOID.placed(turn, shift), trail, friction=FRICTION)
    rows = here.in_contact
    np.testing.assert_array_equal(there.motion, here.motion)
    np.testing.assert_allclose(
        there.point[rows], turn.apply(here.point[rows]) + shift, rtol=0, atol=1e-8
    )
    np.testing.assert_allclose(
        there.reactions.force[rows], turn.apply(here.reactions.force[rows]), rtol=0, atol=1e-7
    )
    np.testing.assert_allclose(there.friction_work, here.friction_work, rtol=0, atol=1e-8)


def test_si_and_the_model_s_units_agree(turning: dict[int, vb.Scan]) -> None:
    model = turning[2]
    rod = vb.Rod(length=0.05, bending_stiffness=6.3e-4)
    surface = vb.surfaces.EllipticParaboloid(a=0.5 / 0.05, b=1.0 / 0.05, h=0.4 * 0.05)
    si = vb.scan(rod, surface, vb.Trail(0.05 * model.trail.position), friction=FRICTION)
    scales: list[tuple[Callable[[vb.Scan], np.ndarray], float]] = [
        (lambda scan: scan.point, 0.05),
        (lambda scan: scan.arc_length, 0.05),
        (lambda scan: scan.reactions.force, 6.3e-4 / 0.05**2),
        (lambda scan: scan.reactions.moment, 6.3e-4 / 0.05),
        (lambda scan: scan.friction_work, 6.3e-4 / 0.05),
        (lambda scan: scan.clamp_work, 6.3e-4 / 0.05),
    ]
    np.testing.assert_array_equal(si.motion, model.motion)
    for field, scale in scales:
        np.testing.assert_allclose(field(si) / scale, field(model), rtol=0, atol=1e-7)


def test_a_short_snap_is_seen_with_any_steps() -> None:
    """The contact jumps by a tenth of the length, and hardly farther than it moved just before."""
    ball = vb.surfaces.Ellipsoid(center=(0, 0, 1.1), semi_axes=(0.6, 0.35, 0.45))
    start, stop = (0.5640752, -0.7317742, 0.2060256), (-0.8288144, 0.4083394, 0.2060256)
    events = [
        vb.scan(UNIT, ball, vb.Trail.line(start=start, stop=stop, count=count), friction=0.3).events
        for count in (121, 241, 481, 961)
    ]
    kinds = ["FIRST_CONTACT", "SNAP", "STICK_TO_SLIP", "DETACH"]
    assert [[event.kind.name for event in some] for some in events] == [kinds] * 4
    places = np.array([[event.parameter for event in some] for some in events])
    np.testing.assert_allclose(places, places[[-1] * 4], rtol=0, atol=5e-4)


def test_a_snap_under_friction_is_in_one_place_with_any_steps() -> None:
    """Where the contact jumps by less than the clamp moves in a few coarse steps."""
    egg = vb.surfaces.Ellipsoid(center=(0.04, 0.052, 0.818), semi_axes=(0.12, 0.159, 0.326))
    for count in (21, 31, 41, 61, 241, 961):
        trail = vb.Trail.line(start=(1, 0.1, 0), stop=(-1, 0.1, 0), count=count)
        events = vb.scan(UNIT, egg, trail, friction=0.193).events
        kinds = ["FIRST_CONTACT", "SNAP", "STICK_TO_SLIP", "DETACH"]
        assert [event.kind.name for event in events] == kinds
        places = [event.parameter for event in events]
        np.testing.assert_allclose(places, [0.4228, 0.495, 0.495, 0.5372], rtol=0, atol=5e-5)


@pytest.mark.parametrize("thing", ["torus", "ball"])
def test_a_heavy_rod_s_contact_begins_once_with_any_steps(thing: str) -> None:
    """Held by friction across its axis, it slides along that from the first: neither a snap nor a
    second contact there, and nothing that sticks before.
    """
    length = 0.05
    wire = vb.Rod.cylinder(length=length, radius=1e-4, youngs_modulus=206e9, density=7850)
    wire = wire.loaded(vb.Loads(gravity=(0, 0, -9.81)))
    torus = vb.surfaces.Torus(
        center=length * np.array([0.0806, -0.1729, 0.9691]),
        axis=(0.2, 0.3, 1),
        major_radius=0.3516 * length,
        minor_radius=0.1 * length,
    )
    ball = vb.surfaces.Sphere(
        center=length * np.array([-0.0743, -0.0003, 0.9406]), radius=0.1572 * length
    )
    surface, sides, kinds = {
        "torus": (torus, (-0.1841, -0.1795), ["FIRST_CONTACT", "TANGENTIAL_TO_TIP", "SNAP"]),
        "ball": (ball, (0.1713, -0.1718), ["FIRST_CONTACT", "SNAP"]),
    }[thing]
    start, stop = ((side * length, y * length, 0) for side, y in zip((1, -1), sides, strict=True))
    for count in (101, 201, 401):
        trail = vb.Trail.line(start=start, stop=stop, count=count)
        scan = vb.scan(wire, surface, trail, friction=FRICTION)
        assert [event.kind.name for event in scan.events][: len(kinds)] == kinds
        first = int(np.flatnonzero(scan.in_contact)[0])
        assert scan.status[first] == vb.Status.OK
        assert scan.motion[first] == vb.Motion.SLIP
