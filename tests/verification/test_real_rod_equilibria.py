"""All equilibria of a tapered rod that is curved at rest, on each kind of surface, against shooting;
and around a snap those of a sweep among them.
"""

from typing import Any

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_random_rods import Whisker, shot

import vibrissa as vb
from vibrissa.forward.equilibria import Equilibrium
from vibrissa.mechanics.model import clamp_of
from vibrissa.mechanics.models import spatial
from vibrissa.surfaces import Surface

WHISKER = Whisker(0.5, (0.5, 0.4), 0.8)
ROD, LENGTH = WHISKER.rod, WHISKER.rod.length
CENTER = np.array([0.25, 0.05, 0.85]) * LENGTH


def residual(one: Equilibrium, surface: Surface) -> float:
    """Largest of what shooting with its reactions leaves: place and moment at the contact, force
    across the normal, slope if tangential, energy.
    """
    force, moment = -one.reactions.force[0], -one.reactions.moment[0]
    force, moment = force / ROD.force_scale, moment / ROD.moment_scale
    clamp, share = one.reactions.trail.position[0], one.arc_length / LENGTH
    end = shot(WHISKER, Rotation.identity(), moment, force, share)
    steps = 1e-6 * LENGTH * np.eye(3)
    levels = surface.levels(np.concatenate([one.point + steps, one.point - steps]))
    normal = levels[:3] - levels[3:]
    normal /= np.linalg.norm(normal)
    push = force / np.linalg.norm(force)
    assert one.kind == (vb.ContactKind.TIP if share > 1 - 1e-9 else vb.ContactKind.TANGENTIAL)
    assert end.tangent @ normal < 1e-4
    left = (
        np.linalg.norm(end.place - (one.point - clamp) / LENGTH),
        np.linalg.norm(end.moment),
        1e-3 * np.linalg.norm(push - normal),  # by differences
        (one.kind == vb.ContactKind.TANGENTIAL) * abs(end.tangent @ normal),
        abs(float(surface.levels(one.point))) / LENGTH,
        abs(end.energy - one.energy / ROD.moment_scale),
    )
    return float(max(left))


def ball_of_triangles() -> Surface:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.2 * LENGTH)
    return vb.surfaces.Mesh(vertices=ball.vertices + CENTER, faces=ball.faces)


SURFACES = {
    "ball": lambda: vb.surfaces.Sphere(center=CENTER, radius=0.2 * LENGTH),
    "ellipsoid": lambda: vb.surfaces.Ellipsoid(
        center=CENTER, semi_axes=np.array([0.2, 0.3, 0.15]) * LENGTH
    ),
    "cylinder": lambda: vb.surfaces.Cylinder(
        center=CENTER, axis=(0.2, 1, 0.1), radius=0.2 * LENGTH, length=LENGTH
    ),
    "torus": lambda: vb.surfaces.Torus(
        center=CENTER,
        axis=(1, 0.3, 0.2),
        major_radius=0.2 * LENGTH,
        minor_radius=0.08 * LENGTH,
    ),
    "union": lambda: vb.surfaces.Union(
        [
            vb.surfaces.Sphere(center=CENTER + np.array(at) * LENGTH, radius=0.15 * LENGTH)
            for at in ((0, 0, 0), (0, 0.2, 0.1))
        ]
    ),
    "implicit": lambda: vb.surfaces.Implicit(
        lambda p: ((p - CENTER) @ (p - CENTER)) / (0.2 * LENGTH) - 0.2 * LENGTH + 0.1 * p[1]
    ),
    "mesh": ball_of_triangles,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SURFACES)
def test_each_is_an_equilibrium_of_the_rod_s_equation(name: str) -> None:
    """The lowest to rounding; unstable ones, at tens of times the force, as errors grow along them."""
    surface = SURFACES[name]()
    found = vb.equilibria(ROD, surface, position=(0, 0, 0))
    assert len(found) >= 4
    assert found[0].stable and not found[-1].stable
    for one in found:
        left, force = residual(one, surface), np.linalg.norm(one.reactions.force) / ROD.force_scale
        print(f"{name}, {one.kind.name}, force {force:.3g}: {left:.1e}")  # noqa: T201
        assert left < (1e-10 if force < 3 else 1e-4)


def test_a_snap_leaves_one_equilibrium_for_another_that_is_lower() -> None:
    """Along the flank of a ball: the sweep's states just before and after are stable equilibria; the
    one that it left is none any more, and the one that it fell into was there before. Of those that
    a search from all starting points finds, it is the lowest stable one.
    """
    ball = vb.surfaces.Sphere(center=(0, 0, 0.95 * LENGTH), radius=0.35 * LENGTH)
    way = np.linspace(1.2, -1.6, 112)
    trail = vb.Trail(np.column_stack([way, 0 * way - 0.2, 0 * way]) * LENGTH)
    scan = vb.scan(ROD, ball, trail)
    (snap,) = (event for event in scan.events if event.kind == vb.EventKind.SNAP)
    after = int(np.argmax(trail.position[:, 0] < snap.clamp[0]))
    before = after - 1
    found = {row: vb.equilibria(ROD, ball, position=trail.position[row]) for row in (before, after)}

    def near(row: int, point: np.ndarray, within: float) -> list[Equilibrium]:
        return [one for one in found[row] if np.linalg.norm(one.point - point) < within * LENGTH]

    for row in found:
        (swept,) = near(row, scan.point[row], 1e-8)
        left = residual(swept, ball)
        print(f"row {row}: {left:.1e}, second variation {swept.second_variation:.2g}")  # noqa: T201
        assert swept.stable and left < 1e-9
        assert swept.energy == pytest.approx(scan.energy[row], abs=1e-10 * ROD.moment_scale)
    assert near(after, scan.point[before], 0.2) == []
    (fallen,) = near(before, scan.point[after], 0.05)
    assert fallen.stable
    assert scan.energy[after] < scan.energy[before] - 0.01 * ROD.moment_scale
    lowest = min(one.energy for one in found[after] if one.stable)
    assert scan.energy[after] == pytest.approx(lowest, abs=1e-10 * ROD.moment_scale)


def wire(base_radius: float, tip_radius: float) -> vb.Rod:
    steel = vb.Rod.tapered(
        length=0.1,
        base_radius=base_radius,
        tip_radius=tip_radius,
        youngs_modulus=206e9,
        density=7850,
        poisson_ratio=0.3,
    )
    return steel.curved(vb.RestShape.arc(0.2, roll=0.7))


WIRE = wire(5e-5, 3e-5)
HEAVY = vb.Loads(gravity=(0, 0, -9.81))
SOFT = vb.Support.compliant(np.diag([0.2, 0.3, 0.5, 0.003, 0.002, 0.005]))


@pytest.mark.parametrize(
    "rod",
    [
        pytest.param(WIRE.loaded(HEAVY), id="heavy"),
        pytest.param(WIRE.on(SOFT), id="softly held"),
        pytest.param(WIRE.loaded(HEAVY).on(SOFT), id="both"),
    ],
)
def test_the_work_of_the_clamp_is_stored_as_potential(rod: vb.Rod) -> None:
    """By which the search after a snap tells equilibria apart: in bending, in the support and in the
    weight. The work follows from the reactions alone, by the trapezoidal rule extrapolated once.
    """
    ball = vb.surfaces.Sphere(center=(0.03, 0, 0.09), radius=0.03)
    works = []
    for count in (81, 161):
        line = vb.Trail.line(start=(-0.03, 0.004, 0), stop=(0.005, 0.004, 0.01), count=count)
        scan = vb.scan(rod, ball, line)
        (first_contact,) = scan.events
        assert first_contact.kind == vb.EventKind.FIRST_CONTACT
        touched = slice((count - 1) * 3 // 5, None)
        works.append(np.sum(scan.clamp_work[touched][1:]))
    work = (4 * works[1] - works[0]) / 3
    lifted = scan.reactions.force[0] @ np.ptp(scan.trail.position[touched], axis=0)
    gain = np.ptp(potentials(scan)[touched]) * rod.moment_scale + lifted
    bent = np.ptp(scan.energy[touched])
    print(f"work {work:.6e}, potential {gain:.6e}, bending {bent:.6e} J")  # noqa: T201
    assert gain == pytest.approx(work, rel=2e-5)
    assert bent < 0.98 * work


def test_a_heavy_rod_snaps_at_one_place_with_any_steps() -> None:
    """By 3 % of its length, shortly before it loses contact, in a support that is soft and turns as it
    yields: there the rod bends more while the potential falls.
    """
    axes, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))
    units = np.diag([1, 1, 1, 0.1, 0.1, 0.1])
    stiffness = 0.485 * units @ axes @ np.diag([1, 2, 3, 1.5, 2.5, 4]) @ axes.T @ units
    rod = wire(1e-4, 5e-5).loaded(HEAVY).on(vb.Support.compliant(stiffness))
    torus = vb.surfaces.Torus(
        center=(0, 0, 0.116), axis=(0.2, 0.1, 1), major_radius=0.035, minor_radius=0.015
    )
    kinds, places = [], []
    for count in (41, 61, 81, 161):
        line = vb.Trail.line(start=(0.07, 0.008, 0), stop=(-0.04, 0.008, 0), count=count)
        events = vb.scan(rod, torus, line).events
        kinds.append([event.kind for event in events])
        places.append([event.parameter for event in events])
    happened = [vb.EventKind.FIRST_CONTACT, vb.EventKind.SNAP, vb.EventKind.DETACH]
    assert kinds == [happened] * len(kinds)
    assert np.ptp(places, axis=0).max() < 1e-8


@pytest.mark.parametrize("count", [61, 121])
def test_a_hanging_thread_snaps_over_a_ball_with_any_steps(count: int) -> None:
    """Clamped level, of a weight of 20 EI/L²: it slides up the ball at its end, falls to the other
    side, and leaves it as far from the ball's middle as it came.
    """
    length = 0.26
    radius = np.sqrt(4 * 1140 * 9.81 * length**3 / (2.5e9 * 20))
    thread = vb.Rod.cylinder(length=length, radius=radius, youngs_modulus=2.5e9, density=1140)
    thread = thread.loaded(vb.Loads(gravity=(0, 9.81, 0)))
    ball = vb.surfaces.Sphere(center=(0, 0.831 * length, 0.438 * length), radius=0.15 * length)
    x = 0.3 * length
    scan = vb.scan(thread, ball, vb.Trail.line(start=(x, 0, 0), stop=(-x, 0, 0), count=count))
    assert (scan.status == vb.Status.OK).all()
    first, snap, last = scan.events
    kinds = vb.EventKind.FIRST_CONTACT, vb.EventKind.SNAP, vb.EventKind.DETACH
    assert (first.kind, snap.kind, last.kind) == kinds
    assert first.parameter + last.parameter == pytest.approx(1.0, abs=1e-9)


def potentials(scan: vb.Scan) -> np.ndarray:
    """Of the rod at positions in contact (n,) [EI/L], given only what a scan tells; elsewhere NaN."""
    rod, model = scan.rod, spatial(scan.rod)
    force, reach = (
        scan.contact_force / rod.force_scale,
        (scan.point - scan.trail.position) / rod.length,
    )
    reactions = scan.reactions.force / rod.force_scale, scan.reactions.moment / rod.moment_scale
    load = -np.hstack(reactions) - np.hstack([force, np.cross(reach, force)])
    clamps = clamp_of(scan.trail.position / rod.length, scan.trail.orientation)
    given = clamps, scan.point / rod.length, np.linalg.norm(force, axis=1), scan.force_direction

    def potential(own: Any, *given: Any) -> Any:
        return model.potential(model.bent(*given, own))

    own = load[:, 6 - model.unknowns :]
    return np.asarray(jax.jit(jax.vmap(potential))(own, *given))
