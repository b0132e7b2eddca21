"""The forward entry point: first contact by geometry, checks and statuses, and what cannot be
scanned.
"""

from pathlib import Path

import numpy as np
import pytest
import xarray

import vibrissa as vb
from vibrissa.io import write_dataset
from vibrissa.numerics.lanes import WIDTH

UNIT = vb.Rod.unit()
STATUS, KIND, EVENT = vb.Status, vb.ContactKind, vb.EventKind


def ball(center: tuple[float, float, float], radius: float) -> vb.surfaces.Surface:
    """A ball, as an object that other tests compile as well."""
    return vb.surfaces.Ellipsoid(center=center, semi_axes=(radius,) * 3).placed()


BESIDE = ball((0.0, 0.0, 0.5), 0.3)
"""The flank of a rod along +z meets it halfway up."""
AHEAD = ball((0.0, 0.0, 1.2), 0.4)
"""Its tip meets this one."""


def line(y: float, start: float = 1.0, stop: float = -0.2, count: int = 49) -> vb.Trail:
    return vb.Trail.line(start=(start, y, 0), stop=(stop, y, 0), count=count)


def test_the_flank_meets_a_ball_beside_the_rod() -> None:
    """Where the ball's centre is a radius from the rod's line, halfway up, tangentially."""
    scan = vb.scan(UNIT, BESIDE, line(0.05, stop=0.1))
    x = np.sqrt(0.3**2 - 0.05**2)
    first = scan.events[0]
    assert first.kind == EVENT.FIRST_CONTACT
    np.testing.assert_allclose(first.clamp, [x, 0.05, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(first.point, [x, 0.05, 0.5], rtol=0, atol=1e-6)
    rows = np.flatnonzero(scan.in_contact)
    assert scan.trail.position[rows[0], 0] < x <= scan.trail.position[rows[0] - 1, 0]
    np.testing.assert_array_equal(scan.kind[rows], KIND.TANGENTIAL)


def test_the_tip_meets_a_ball_ahead() -> None:
    """Where the tip's distance from the centre is the radius."""
    scan = vb.scan(UNIT, AHEAD, line(0.1))
    x = np.sqrt(0.4**2 - 0.1**2 - 0.2**2)
    assert scan.events[0].kind == EVENT.FIRST_CONTACT
    np.testing.assert_allclose(scan.events[0].clamp, [x, 0.1, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(scan.events[0].point, [x, 0.1, 1.0], rtol=0, atol=1e-9)
    assert scan.kind[np.flatnonzero(scan.in_contact)[0]] == KIND.TIP
    assert scan.events[0].parameter == pytest.approx((1.0 - x) / 1.2, abs=1e-9)


def test_passing_by_touches_nothing() -> None:
    scan = vb.scan(UNIT, AHEAD, line(0.6))
    assert scan.events == []
    np.testing.assert_array_equal(scan.kind, KIND.NONE)
    np.testing.assert_array_equal(scan.status, STATUS.OK)
    np.testing.assert_array_equal(scan.reactions.force, 0)
    assert np.all(np.isnan(scan.point))


def test_a_light_touch_is_a_cantilever() -> None:
    """To first order in the deflection w at the tip: f = 3 EI w/L³ across the rod, moment f L at
    the clamp, energy f w/2.
    """
    start = np.sqrt(0.4**2 - 0.1**2 - 0.2**2)
    scan = vb.scan(
        UNIT, AHEAD, vb.Trail.line(start=(start, 0.1, 0), stop=(start - 1e-4, 0.1, 0), count=3)
    )
    across = scan.point[2, :2] - scan.trail.position[2, :2]
    force = -scan.reactions.force[2]
    np.testing.assert_allclose(force[:2], 3 * across, rtol=1e-3)
    np.testing.assert_allclose(
        scan.reactions.moment[2, :2], np.array([force[1], -force[0]]), rtol=1e-3
    )
    assert scan.energy[2] == pytest.approx(1.5 * across @ across, rel=1e-3)


def test_head_on_contact_gives_no_number() -> None:
    """Straight up into the ball's lowest point: the force would act along the rod."""
    trail = vb.Trail.line(start=(0, 0, -0.4), stop=(0, 0, 0.1), count=21)
    scan = vb.scan(UNIT, AHEAD, trail)
    below = trail.position[:, 2] < -0.2 - 1e-9
    head_on = [event for event in scan.events if event.kind == EVENT.HEAD_ON]
    np.testing.assert_allclose(head_on[0].clamp, [0, 0, -0.2], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(scan.status[below], STATUS.OK)
    assert np.all(scan.status[~below][1:] == STATUS.HEAD_ON)
    assert np.all(np.isnan(scan.reactions.force[~below][1:]))
    assert not np.any(scan.in_contact)


def test_a_clamp_inside_the_object_at_every_position_is_refused() -> None:
    with pytest.raises(
        ValueError,
        match=r"trail.position = \[0.0, 0.0, 1.2\] …: the clamp is inside the object; allowed is outside",
    ):
        vb.scan(UNIT, AHEAD, vb.Trail.line(start=(0, 0, 1.2), stop=(0.1, 0, 1.2), count=3))


def test_where_the_clamp_is_inside_the_rows_say_so() -> None:
    trail = vb.Trail.line(start=(1.0, 0.1, 0.5), stop=(-1.0, 0.1, 0.5), count=49)
    scan = vb.scan(UNIT, BESIDE, trail)
    inside = np.linalg.norm(trail.position - [0, 0, 0.5], axis=1) < 0.3
    assert np.count_nonzero(inside) > 5
    np.testing.assert_array_equal(scan.status == STATUS.CLAMP_INSIDE, inside)
    assert np.all(np.isnan(scan.reactions.force[inside]))


def test_one_position_in_contact_is_that_of_a_sweep() -> None:
    """A trail that begins in contact: the equilibrium of least energy, which here is the one a
    sweep comes to.
    """
    sweep = vb.scan(UNIT, AHEAD, line(0.1))
    row = int(np.flatnonzero(sweep.in_contact)[3])
    alone = vb.scan(UNIT, AHEAD, vb.Trail(sweep.trail.position[row : row + 1]))
    assert [event.kind for event in alone.events] == [EVENT.STARTED_IN_CONTACT]
    np.testing.assert_allclose(alone.point[0], sweep.point[row], rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        alone.reactions.force[0], sweep.reactions.force[row], rtol=0, atol=1e-9
    )


def test_bending_strain_is_radius_times_curvature_and_is_held_against_the_yield_strain() -> None:
    """κ(0) = ‖m0‖/EI, and the curvature is nowhere larger."""
    wire = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9, yield_strain=2e-3)
    scaled = vb.surfaces.Ellipsoid(center=(0, 0, 0.06), semi_axes=(0.02,) * 3).placed()
    scan = vb.scan(
        wire, scaled, vb.Trail.line(start=(0.05, 0.005, 0), stop=(-0.01, 0.005, 0), count=49)
    )
    moment = np.linalg.norm(scan.reactions.moment, axis=1)
    strain = 0.25e-3 * moment / wire.bending_stiffness
    np.testing.assert_allclose(scan.bending_strain, strain, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(scan.status == STATUS.OVERSTRAINED, strain > 2e-3)
    assert 0 < np.count_nonzero(strain > 2e-3) < np.count_nonzero(scan.in_contact)
    row = int(np.argmax(strain))
    points = scan.elastic_line(row, 400)
    bend = np.linalg.norm(points[2:] - 2 * points[1:-1] + points[:-2], axis=1) / (0.05 / 399) ** 2
    assert 0.25e-3 * bend.max() == pytest.approx(strain[row], rel=2e-2)


def test_a_strain_needs_a_radius() -> None:
    with pytest.raises(ValueError, match=r"radius = None"):
        _ = vb.scan(UNIT, AHEAD, line(0.6)).bending_strain


def test_elastic_line_says_what_it_needs() -> None:
    scan = vb.scan(UNIT, AHEAD, vb.Trail.stack([line(0.1), line(0.6)]))
    np.testing.assert_allclose(scan.elastic_line((1, 5), 3)[:, 2], [0, 0.5, 1.0], atol=1e-15)
    with pytest.raises(ValueError, match=r"count = 1; allowed is at least 2"):
        scan.elastic_line((0, 20), 1)
    with pytest.raises(ValueError, match=r"index = 1; allowed is \(trail, i\)"):
        scan.elastic_line(1)
    with pytest.raises(IndexError):
        scan.elastic_line((2, 0))
    head_on = vb.scan(UNIT, AHEAD, vb.Trail.line(start=(0, 0, -0.4), stop=(0, 0, 0.1), count=21))
    with pytest.raises(
        ValueError, match=r"index = 20: this position was not solved: .*clamp's axis"
    ):
        head_on.elastic_line(20)


def test_a_scan_is_read_back_from_netcdf_as_it_was(tmp_path: Path) -> None:
    scan = vb.scan(UNIT, AHEAD, line(0.1))
    file = write_dataset(tmp_path / "scan.nc", scan.to_dataset())
    with xarray.open_dataset(file, engine="h5netcdf") as data:
        for name, values in (
            ("contact_point", scan.point),
            ("normal", scan.normal),
            ("arc_length", scan.arc_length),
            ("support_force", scan.reactions.force),
            ("support_moment", scan.reactions.moment),
            ("bending_energy", scan.energy),
            ("kind", scan.kind),
            ("status", scan.status),
            ("axial_slip", scan.slip.axial),
            ("lateral_slip", scan.slip.lateral),
            ("event_kind", [int(event.kind) for event in scan.events]),
            ("event_parameter", [event.parameter for event in scan.events]),
        ):
            np.testing.assert_array_equal(data[name].values, values)
        assert data["contact_point"].attrs["units"] == "1"
        meanings = data["event_kind"].attrs["flag_meanings"].split()
        assert (
            meanings[list(data["event_kind"].attrs["flag_values"]).index(scan.events[0].kind)]
            == "first_contact"
        )


CURVED = vb.Rod.unit().curved(vb.RestShape.arc(0.8))


def test_a_curved_rod_is_not_met_head_on() -> None:
    """A force along the clamp's axis bends it to the side to which it is curved."""
    wall = vb.surfaces.Plane(point=(0, 0, 0.9), normal=(0, 0, -1))
    trail = vb.Trail.line(start=(0, 0, 0), stop=(0, 0, 0.4), count=9)
    scan = vb.scan(CURVED, wall, trail)
    assert np.all(scan.status == STATUS.OK)
    assert scan.in_contact[3:].all()
    assert np.all(scan.point[3:, 0] > 0.3)


def test_a_hook_whose_tip_meets_a_wall_squarely_opens() -> None:
    """A quarter of a circle: the force runs along its tip, not along the clamp's axis."""
    hook = vb.Rod.unit().curved(vb.RestShape.arc(2 / np.pi))
    trail = vb.Trail.line(start=(0, 0, 0), stop=(0.3, 0, 0), count=7)
    square, tilted = (
        vb.scan(hook, vb.surfaces.Plane(point=(2 / np.pi + 0.1, 0, 0), normal=normal), trail)
        for normal in ((-1, 0, 0), (-1, 0, 1e-7))
    )
    assert np.all(square.status == STATUS.OK)
    assert square.in_contact[3:].all()
    np.testing.assert_allclose(square.reactions.force, tilted.reactions.force, atol=1e-6)


@pytest.mark.parametrize("place", [0.3, 0.6, 0.9])
def test_a_rod_that_rests_through_the_object_starts_in_contact(place: float) -> None:
    """The trail begins where the curve at rest passes through a ball, from side to side."""
    middle = (0.8 * (1 - np.cos(place / 0.8)), 0.01, 0.8 * np.sin(place / 0.8))
    ball = vb.surfaces.Sphere(center=middle, radius=0.05)
    scan = vb.scan(CURVED, ball, vb.Trail.line(start=(0, 0, 0), stop=(-0.4, 0, 0), count=9))
    assert scan.events[0].kind == EVENT.STARTED_IN_CONTACT
    assert scan.kind[0] != vb.ContactKind.NONE
    assert np.all(scan.status == STATUS.OK)
    assert np.isfinite(scan.reactions.force).all()


@pytest.mark.parametrize("rod", [UNIT, CURVED], ids=["straight", "curved"])
def test_events_of_many_trails_are_those_of_each_alone(rod: vb.Rod) -> None:
    """Many are roots of the conditions and of what changes sign; few are bracketed by equilibria."""
    ball = vb.surfaces.Sphere(center=(0.0, 0.0, 1.1), radius=0.5)
    sweeps = [line(y, 0.9, -0.9) for y in np.linspace(-0.3, 0.25, 60)]
    many = vb.scan(rod, ball, vb.Trail.stack(sweeps)).events
    assert len(many) > len(sweeps) + WIDTH
    for trail in (0, 27, 59):
        own = [event for event in many if event.trail == trail]
        alone = vb.scan(rod, ball, sweeps[trail]).events
        assert [event.kind for event in own] == [event.kind for event in alone]
        for here, there in zip(own, alone, strict=True):
            assert here.parameter == pytest.approx(there.parameter, abs=1e-11)
            np.testing.assert_allclose(here.point, there.point, atol=1e-9)


def test_events_at_a_thin_tip_do_not_depend_on_the_steps() -> None:
    """Of a twentieth of the clamp's radius, and curved: coarse steps of 0.05 L, and a quarter."""
    rod = vb.Rod.tapered(
        length=1.0, base_radius=0.01, tip_radius=5e-4, youngs_modulus=4 / (np.pi * 1e-8)
    ).curved(vb.RestShape.arc(radius=1.5))
    bowl = vb.surfaces.EllipticParaboloid(0.5, 1.0, 0.5)
    ends = (-0.97, -0.545, 0.025), (0.75, 0.824, 0.025)
    turned = (0.0, -0.1003, -0.1295, 0.9865)
    coarse, fine = (
        vb.scan(rod, bowl, vb.Trail(np.linspace(*ends, count), turned)).events
        for count in (50, 197)
    )
    assert EVENT.TANGENTIAL_TO_TIP in [event.kind for event in coarse]
    assert [event.kind for event in coarse] == [event.kind for event in fine]
    for here, there in zip(coarse, fine, strict=True):
        assert here.parameter == pytest.approx(there.parameter, abs=1e-8)


def test_a_change_of_phase_where_a_face_lets_the_rod_lie_down_is_an_event_with_any_steps() -> None:
    """Along a flat face contact goes from the tip to a flank that rolls over an edge, all at once:
    the change of phase may end one stretch or lie in the middle of another.
    """
    rod = vb.Rod.cylinder(length=1.0, radius=0.01, youngs_modulus=4 / (np.pi * 1e-8))
    block = vb.surfaces.Box(center=(0.0, 0.0, 0.95), half_extents=(0.35, 0.25, 0.2))
    ends = (-0.2816, 0.375, -0.0128), (-0.2626, 0.176, -0.0128)
    turned = (0.0201, 0.1893, -0.0342, 0.9811)
    found = [
        vb.scan(rod, block, vb.Trail(np.linspace(*ends, count), turned), finite_radius=True).events
        for count in (5, 9, 17, 33, 65)
    ]
    assert [event.kind for event in found[0]] == [EVENT.FIRST_CONTACT, EVENT.TIP_TO_TANGENTIAL]
    for events in found[1:]:
        assert [event.kind for event in events] == [event.kind for event in found[0]]
        for here, there in zip(events, found[0], strict=True):
            assert here.parameter == pytest.approx(there.parameter, abs=1e-8)
