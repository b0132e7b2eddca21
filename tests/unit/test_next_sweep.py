"""Which sweep is proposed next: one that touches what is unknown, that may be driven, and that takes as
much uncertainty away as it is said to.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from touched import NORMAL, POINT, joined, on_surface, rings

import vibrissa as vb
from vibrissa.shape.kernel import covariance
from vibrissa.shape.plan import _Gains, _Planned
from vibrissa.shape.prior import Ball
from vibrissa.shape.stated import Stated

WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
OBJECT = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.026, 0.021, 0.017))
COUNT = 60
IDENTITY = Rotation.identity().as_quat()


def stand(turn: Rotation, offset: float) -> vb.Trail:
    """A line across the object from one side."""
    along = np.linspace(0.042, -0.042, COUNT)
    position = np.column_stack([along, np.full(COUNT, offset), np.full(COUNT, -0.052)])
    return vb.Trail(turn.apply(position), np.tile(turn.as_quat(), (COUNT, 1)))


def felt(
    trail: vb.Trail, rng: np.random.Generator, touched: vb.surfaces.Surface = OBJECT
) -> vb.Contacts:
    """Where the rod's centre line touches there, with errors."""
    scan = vb.scan(WIRE, touched, trail)
    rows = scan.in_contact & (scan.status == vb.Status.OK)
    count = int(rows.sum())
    normal = scan.normal[rows] + NORMAL * rng.normal(size=(count, 3))
    return vb.Contacts(
        scan.point[rows] + scan.offset * scan.normal[rows] + POINT * rng.normal(size=(count, 3)),
        normal / np.linalg.norm(normal, axis=1)[:, None],
        np.tile(POINT**2 * np.eye(3), (count, 1, 1)),
        np.tile(NORMAL**2 * np.eye(3), (count, 1, 1)),
    )


SIDES = [Rotation.from_euler("x", 90 * i, degrees=True) for i in range(4)]
SIDES += [Rotation.from_euler("y", angle, degrees=True) for angle in (90, -90)]
CANDIDATES = vb.Trail.stack([stand(side, offset) for side in SIDES for offset in (-0.008, 0.006)])


@pytest.fixture(scope="module")
def known() -> list[vb.Contacts]:
    rng = np.random.default_rng(0)
    return [felt(stand(SIDES[0], offset), rng) for offset in (-0.010, -0.003, 0.004, 0.011)]


@pytest.fixture(scope="module")
def ranked(known) -> vb.NextSweep:
    return vb.next_sweep(vb.fit_shape(known), WIRE, CANDIDATES)


def test_what_is_known_already_comes_last(ranked):
    assert sorted(ranked.order) == list(range(len(CANDIDATES.position)))
    assert np.all(ranked.status == vb.Status.OK)
    assert set(ranked.order[-2:]) == {0, 1}
    assert ranked.gain[ranked.order[0]] > 10 * ranked.gain[:2].max()
    assert np.array_equal(ranked.best.position, CANDIDATES.position[ranked.order[0]])


def test_two_ends_are_a_sweep(known, ranked):
    ends = vb.Trail(CANDIDATES.position[:, [0, -1]], CANDIDATES.orientation[:, [0, -1]])
    found = vb.next_sweep(vb.fit_shape(known), WIRE, ends)
    assert found.order[0] == ranked.order[0]
    assert np.allclose(found.gain, ranked.gain, rtol=0.1, atol=0.02 * ranked.unknown)


def test_gain_is_what_the_sweep_then_takes_away(known, ranked):
    places = on_surface(OBJECT, 0.02 * np.random.default_rng(1).normal(size=(500, 3)))
    before = vb.fit_shape(known).deviation(places).mean()
    rng, told, true = np.random.default_rng(2), [], []
    for row in range(2, len(ranked.order), 2):
        after = vb.fit_shape([*known, felt(CANDIDATES[row], rng)]).deviation(places).mean()
        told.append(ranked.gain[row] / ranked.unknown)
        true.append(1 - after / before)
    assert np.corrcoef(told, true)[0, 1] > 0.5
    best = int(np.argmax(told))
    assert true[best] > max(true) - 0.15
    assert np.allclose(told, true, atol=0.35)


def test_what_contacts_take_away_is_that_of_plain_conditioning(known):
    shape = vb.fit_shape(known)
    found, rng = shape.level.found, np.random.default_rng(3)
    assert len(found.basis.sites.value) == len(shape.sites.point)
    places, new = (on_surface(OBJECT, 0.02 * rng.normal(size=(count, 3))) for count in (30, 6))
    gains = _Gains.of(shape, places, None)
    normal = shape.normal(new)
    raised = new + shape.level.above * normal
    above = shape.level.feet(places, shape.extent).raised
    both = shape.level.places(np.concatenate([above, raised]))
    prior = covariance(found.basis.kernel, both, both)
    root = np.linalg.inv(found.basis.inverse)
    among = root @ root.T
    weights = np.linalg.solve(among, covariance(found.basis.kernel, found.basis.sites, both)).T
    precision = found.root @ found.root.T
    of_sites = root @ np.linalg.solve(precision, root.T)
    given = prior + weights @ (of_sites - among) @ weights.T
    told, values = np.arange(4 * 30, 4 * 36), 4 * np.arange(30)
    seen = given[np.ix_(told, told)] + block_diag(*gains._errors(raised, normal))
    cross = given[np.ix_(values, told)]
    left = np.diag(given)[values] - np.sum(cross * np.linalg.solve(seen, cross.T).T, axis=1)
    contacts = np.concatenate([shape.sites.touched, new])
    away = KDTree(contacts).query(places)[0]
    aside = Stated.at(shape.level, places, contacts, shape.extent).aside
    stated = gains.stated._replace(aside=np.minimum(gains.stated.aside, aside), away=away)
    assert stated.aside.mean() < gains.stated.aside.mean()
    wanted = gains.unknown - stated.deviations(np.maximum(left, 0)).mean()
    assert gains.expected([new])[0] == pytest.approx(wanted, rel=1e-4)
    assert gains.unknown == pytest.approx(shape.deviation(places).mean(), rel=1e-6)
    twice = np.concatenate([new[:3], new[:3]])
    assert gains.expected([twice])[0] == pytest.approx(gains.expected([new[:3]])[0], rel=1e-9)


BLOCK = vb.surfaces.Offset(
    vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.018, 0.012, 0.015)), 0.003
)


def test_sweeps_over_a_block_that_is_hardly_known_find_what_they_promise():
    """Of what the best of some 50 lines would take away, if its contacts were known before, after
    two to five. The mean surface bulges where the block ends.
    """
    lines = vb.Trail.stack([stand(side, y) for side in SIDES for y in 0.006 * np.arange(-4, 5)])
    rng, known_rows = np.random.default_rng(4), np.random.default_rng(1)
    told = [felt(line, rng, BLOCK) for line in lines]
    touching = np.flatnonzero([len(contacts) > 5 for contacts in told])
    taken, best = [], []
    for state in range(8):
        rows = known_rows.choice(touching, 2 + state % 4, replace=False)
        shape, left = vb.fit_shape([told[row] for row in rows]), np.setdiff1d(range(54), rows)
        gains = _Gains.of(shape, _Planned.of(shape).places, 2e-3)
        true = gains.expected([told[row].point for row in left])
        taken.append(true[vb.next_sweep(shape, WIRE, lines[left], tolerance=2e-3).order[0]])
        best.append(true.max())
    assert sum(taken) > 0.75 * sum(best)


def test_sweeps_along_a_side_that_was_not_touched_may_be_driven():
    """Flat faces beside it go on, and do not reach the clamps there; closer ones may be inside."""
    lines = vb.Trail.stack([stand(side, y) for side in SIDES for y in 0.006 * np.arange(-4, 5)])
    rows = [3, 4, 5, 6, 21, 22, 24, 30, 33, 39, 40, 42, 48, 49, 50]
    rng = np.random.default_rng(4)
    shape = vb.fit_shape([felt(lines[row], rng, BLOCK) for row in rows])
    beyond = lines[11:16]
    assert np.all(vb.next_sweep(shape, WIRE, beyond).status == vb.Status.OK)
    close = vb.Trail(0.3 * beyond.position, beyond.orientation)
    assert np.all(vb.next_sweep(shape, WIRE, close).status == vb.Status.CLAMP_INSIDE)
    # 52 mm from its middle, 37 mm from the face: half a mount's width and what is uncertain.
    wide = vb.next_sweep(shape, WIRE, beyond, clearance=0.035)
    assert np.all(wide.status == vb.Status.CLAMP_INSIDE)


def test_the_mean_level_grows_smoothly_beyond_all_contacts():
    rng = np.random.default_rng(0)
    ball = Ball(np.array([0.01, 0, 0]), 0.02)
    points = 0.03 * rng.normal(size=(200, 3))
    contacts = ball.center + 0.021 * np.eye(3)
    grown = ball.growing(contacts)
    near = ball.at(points)[:, 0] < ball.at(contacts)[:, 0].max()
    assert 10 < near.sum() < 190
    assert np.array_equal(grown.at(points[near]), ball.at(points[near]))
    assert np.all(grown.at(points[~near])[:, 0] > ball.at(points[~near])[:, 0])
    step = 1e-6 * np.eye(3)
    for each in (ball, grown):
        moved = [each.at(points + axis) - each.at(points - axis) for axis in step]
        slopes = np.stack(moved, axis=-1) / 2e-6
        jets = each.at(points)
        assert np.allclose(slopes[:, 0], jets[:, 1:], atol=1e-7)
        assert np.allclose(slopes[:, 1:], each.curvature(points), rtol=1e-6, atol=1e-3)


def test_a_rod_that_is_driven_deep_is_expected_where_it_enters():
    """Across the end of a block, 24 mm deep, be the surface where its mean is or lower: what is
    deepest inside is nearer to its sides.
    """
    block = vb.surfaces.Offset(
        vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.010, 0.008, 0.018)), 0.003
    )
    shape = vb.fit_shape(rings(block, np.random.default_rng(1), sweeps=9))
    trail = vb.Trail(
        stand(Rotation.identity(), 0.002).position[None], np.tile(IDENTITY, (1, 60, 1))
    )
    (deepest,), *lower = _Planned.of(shape).straight(WIRE, trail)
    assert np.mean(deepest[:, 2] < -0.017) < 0.2
    for (enters,) in lower:
        assert np.mean(enters[:, 2] < -0.017) > 0.8
    for (points,) in ((deepest,), *lower):
        assert np.median(np.abs(block.distances(points))) < 0.5e-3


def test_contacts_are_expected_where_they_will_be(ranked):
    for row in np.flatnonzero(ranked.scanned):
        if len(ranked.contacts[row]):
            assert np.median(np.abs(OBJECT.distances(ranked.contacts[row]))) < 0.006


def test_a_rod_that_would_yield_or_hit_with_its_clamp_is_refused(known):
    shape = vb.fit_shape(known)
    brittle = replace(WIRE, yield_strain=1e-5)
    close = vb.Trail(CANDIDATES.position * 0.3, CANDIDATES.orientation)
    ranked = vb.next_sweep(shape, brittle, CANDIDATES)
    assert np.all(ranked.status[ranked.gain == 0] == vb.Status.OVERSTRAINED)
    with pytest.raises(ValueError, match=r"none of 12 may be driven.*OVERSTRAINED"):
        _ = ranked.best
    away = vb.next_sweep(shape, WIRE, vb.Trail.stack([stand(SIDES[2], 0.0), close[4]]))
    assert away.order.tolist() == [0, 1]
    assert away.status.tolist() == [vb.Status.OK, vb.Status.CLAMP_INSIDE]
    kept = vb.next_sweep(shape, WIRE, CANDIDATES[:2], clearance=0.04)
    assert np.all(kept.status == vb.Status.CLAMP_INSIDE)


def test_with_a_tolerance_the_share_of_the_surface_counts(known):
    ranked = vb.next_sweep(vb.fit_shape(known), WIRE, CANDIDATES, tolerance=1e-3)
    assert 0.3 < ranked.unknown < 1.0
    assert np.all(ranked.gain <= ranked.unknown)
    assert ranked.gain.max() > 0.05


def test_a_sweep_that_misses_gains_nothing(known):
    off = vb.Trail(CANDIDATES.position + [0.2, 0, 0], CANDIDATES.orientation)
    assert np.all(vb.next_sweep(vb.fit_shape(known), WIRE, off).gain == 0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"tolerance": 0.0}, r"tolerance = 0.*; allowed is"),
        ({"clearance": -1.0}, r"clearance = -1.*; allowed is"),
        ({"places": [[np.nan, 0, 0]]}, r"places\[0, 0\] = nan; allowed are finite"),
        ({"places": np.zeros((0, 3))}, r"places is empty; allowed is"),
    ],
)
def test_bad_arguments_are_named(known, arguments, said):
    with pytest.raises(ValueError, match=said):
        vb.next_sweep(vb.fit_shape(known), WIRE, CANDIDATES, **arguments)


def test_contacts_of_several_sweeps_are_numbered_through(known):
    whole = vb.Contacts.joined([known[0], joined(known[1:3]), known[3]])
    assert len(whole) == sum(map(len, known))
    assert np.array_equal(np.unique(whole.sweep), np.arange(4))
    one, other = vb.fit_shape(whole), vb.fit_shape(known)
    places = on_surface(OBJECT, 0.02 * np.random.default_rng(1).normal(size=(50, 3)))
    assert np.array_equal(one.distance(places), other.distance(places))
