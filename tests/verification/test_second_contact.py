"""Objects that a rod can touch in two places: what is returned as one contact is one, and where it
is not, the row says so and where.

The judge is a fine elastic line and the exact distance from the object, written out here in NumPy.
Model units.
"""

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
import shooting

import vibrissa as vb
from vibrissa.forward.assess import parabolas
from vibrissa.surfaces import Box, Sphere, Surface, Torus, Union

Distance = Callable[[np.ndarray], np.ndarray]
COUNT, POINTS = 121, 2000
# Depth [L] that may go unseen: of points L/270 apart on a part of radius 0.05, 3.5e-5.
UNSEEN = 4e-5
NEAR = 0.02


def sphere(center: tuple[float, ...], radius: float) -> Distance:
    return lambda p: np.linalg.norm(p - np.array(center), axis=-1) - radius


def box(center: tuple[float, ...], half_extents: tuple[float, ...]) -> Distance:
    def distance(p: np.ndarray) -> np.ndarray:
        beyond = np.abs(p - np.array(center)) - np.array(half_extents)
        return np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(axis=-1), 0)

    return distance


def torus(
    center: tuple[float, ...], axis: tuple[float, ...], major: float, minor: float
) -> Distance:
    e = np.array(axis) / np.linalg.norm(axis)

    def distance(p: np.ndarray) -> np.ndarray:
        along = (p - np.array(center)) @ e
        across = np.linalg.norm(p - np.array(center) - along[..., None] * e, axis=-1)
        return np.hypot(across - major, along) - minor

    return distance


class Place(NamedTuple):
    """An object, the distances from its parts, and a trail along −x at y = `side`."""

    surface: Surface
    parts: list[Distance]
    side: float

    def distances(self, points: np.ndarray) -> np.ndarray:
        """From the whole object."""
        return np.min([part(points) for part in self.parts], axis=0)


# Out of the rod's reach: all objects are of one kind, which is compiled once.
FAR = (9.0, 9.0, 9.0)
BALL, NO_BLOCK, NO_RING = (FAR, 0.1), (FAR, (0.1, 0.1, 0.1)), (FAR, (0, 0, 1), 0.2, 0.1)


def place(
    side: float,
    one: tuple[tuple[float, ...], float] = BALL,
    other: tuple[tuple[float, ...], float] = BALL,
    block: tuple[tuple[float, ...], tuple[float, ...]] = NO_BLOCK,
    ring: tuple[tuple[float, ...], tuple[float, ...], float, float] = NO_RING,
) -> Place:
    surface = Union([Sphere(*one), Sphere(*other), Box(*block), Torus(*ring)])
    return Place(surface, [sphere(*one), sphere(*other), box(*block), torus(*ring)], side)


PLACES = {
    # The rod bends round the upper one, and before it lets go the lower one is in its way.
    "low behind high": place(0.02, ((0, 0.1, 0.95), 0.2), ((-0.2, -0.12, 0.6), 0.15)),
    # Its tip lets go of the first, and there is room before the second.
    "apart": place(0.0, ((0.3, 0.1, 0.8), 0.15), ((-0.15, -0.1, 0.55), 0.15)),
    # Bent by the lower one, it meets the upper one farther out.
    "high behind low": place(0.03, ((0.35, 0.0, 0.5), 0.12), ((0.0, 0.05, 0.9), 0.25)),
    # It slides into the crease between them, from where no single contact leads on.
    "into the crease": place(0.06, ((0.1, 0, 0.9), 0.15), ((-0.25, 0, 0.85), 0.25)),
    # Sharp edges, of which a bent rod knows nothing until it enters them.
    "block behind ball": place(
        0.05, ((0.1, 0.1, 0.9), 0.2), block=((-0.15, 0, 0.45), (0.1, 0.3, 0.1))
    ),
    # Through the hole of a ring.
    "ring": place(0.05, ring=((0, -0.07, 0.64), (0.8, 0.2, -0.3), 0.2, 0.07)),
}
ALL = pytest.mark.parametrize("name", PLACES)


@cache
def swept(name: str) -> vb.Scan:
    surface, _, side = PLACES[name]
    return vb.scan(
        vb.Rod.unit(),
        surface,
        vb.Trail.line(start=(1.2, side, 0), stop=(-1.2, side, 0), count=COUNT),
    )


def deepest(name: str, i: int) -> tuple[np.ndarray, float]:
    """Deepest point of the elastic line at a position, and its depth."""
    line = swept(name).elastic_line(int(i), POINTS)
    distance = PLACES[name].distances(line)
    k = int(np.argmin(distance))
    return line[k], -float(distance[k])


@ALL
def test_a_good_row_has_one_contact(name: str) -> None:
    scan = swept(name)
    for i in np.flatnonzero(scan.status == vb.Status.OK):
        assert deepest(name, i)[1] < UNSEEN
        assert np.all(np.isnan(scan.second_contact[i]))


@ALL
def test_a_rod_that_enters_the_object_says_where(name: str) -> None:
    scan = swept(name)
    wrong = np.flatnonzero(scan.solved & (scan.status != vb.Status.OK))
    for i in wrong:
        where, depth = deepest(name, i)
        assert scan.status[i] == vb.Status.PENETRATING
        assert depth > 0
        assert scan.depth[i] == pytest.approx(depth, abs=5e-4)
        np.testing.assert_allclose(scan.second_contact[i], where, rtol=0, atol=NEAR)
        assert PLACES[name].distances(scan.second_contact[i]) < 0
        assert np.linalg.norm(scan.second_contact[i] - scan.point[i]) > NEAR
    assert bool(len(wrong)) == (name != "apart"), scan.status


@ALL
def test_each_row_is_a_rod_in_space_that_touches_where_it_says(name: str) -> None:
    """Also one that enters the object elsewhere: it is an equilibrium, of the one contact."""
    scan = swept(name)
    touching = np.flatnonzero(scan.in_contact)
    np.testing.assert_allclose(PLACES[name].distances(scan.point[touching]), 0, atol=1e-9)
    for i in touching[:: len(touching) // 6]:
        force, moment = -scan.reactions.force[i], -scan.reactions.moment[i]
        end = shooting.rod_along(
            scan.trail.position[i], (0, 0, 1), moment, force, [scan.arc_length[i]]
        )[-1]
        np.testing.assert_allclose(end[:3], scan.point[i], rtol=0, atol=1e-9)
        np.testing.assert_allclose(end[6:9], 0, atol=1e-9)
        touched_part = PLACES[name].parts[
            int(np.argmin([abs(part(scan.point[i])) for part in PLACES[name].parts]))
        ]
        assert touched_part(scan.point[i] + 1e-4 * force / np.linalg.norm(force)) == pytest.approx(
            1e-4, abs=1e-7
        )


def touched(name: str) -> list[int]:
    """Which part each row in contact is on, row after row, each once."""
    scan = swept(name)
    parts = np.argmin(
        np.abs([part(scan.point[scan.in_contact]) for part in PLACES[name].parts]), axis=0
    )
    return [int(part) for k, part in enumerate(parts) if k == 0 or part != parts[k - 1]]


@pytest.mark.parametrize(
    ("name", "leaves", "arrives"),
    [
        ("low behind high", vb.EventKind.DETACH, vb.EventKind.FIRST_CONTACT),
        ("apart", vb.EventKind.DETACH, vb.EventKind.FIRST_CONTACT),
        ("high behind low", vb.EventKind.DETACH, vb.EventKind.FIRST_CONTACT),
        ("into the crease", vb.EventKind.SNAP, vb.EventKind.STARTED_IN_CONTACT),
    ],
)
def test_the_contact_goes_on_to_the_other_part_and_an_event_says_so(
    name: str, leaves: vb.EventKind, arrives: vb.EventKind
) -> None:
    scan = swept(name)
    one, other = PLACES[name].parts[:2]
    assert touched(name) == [0, 1]
    kinds = [event.kind for event in scan.events]
    between = kinds.index(leaves)
    assert kinds[between + 1] == arrives
    left, met = scan.events[between : between + 2]
    assert one(left.point) == pytest.approx(0, abs=1e-9)
    assert other(left.point) > -1e-9
    assert abs(other(met.point)) < NEAR
    assert left.parameter <= met.parameter
    # The rows before the one and behind the other are on the part that they are said to be on.
    x = scan.trail.position[:, 0]
    before, behind = scan.in_contact & (x > left.clamp[0]), scan.in_contact & (x < met.clamp[0])
    np.testing.assert_allclose(one(scan.point[before]), 0, atol=1e-9)
    np.testing.assert_allclose(other(scan.point[behind]), 0, atol=1e-9)
    assert before.any() and behind.any()


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("finer", [1, 2, 4])
def test_a_contact_that_ends_inside_another_part_hands_over_to_it(
    finer: int, friction: float
) -> None:
    """The clamp bends the rod round the upper ball, goes on round it to where the lower one is, and
    leaves the upper one there: where the straight rod touches that, by exact geometry, the contact
    ends and the next one begins.
    """
    there = place(0.0, ((0, 0, 0.9), 0.2), ((0.02, 0.3, 0.5), 0.15))
    way = np.array([(0.4, 0, 0), (0.1, 0.03, 0), (0.02, 0.12, 0), (0.02, 0.35, 0)])
    shares = np.linspace(0, 1, 12 * finer, endpoint=False)[:, None]
    steps = [a + shares * (b - a) for a, b in pairwise(way)]
    trail = vb.Trail(np.concatenate([*steps, way[-1:]]))
    scan = vb.scan(vb.Rod.unit(), there.surface, trail, friction=friction)
    kinds = (vb.EventKind.FIRST_CONTACT, vb.EventKind.DETACH)
    met, left, met_next = [event for event in scan.events if event.kind in kinds]
    assert met_next.kind == vb.EventKind.FIRST_CONTACT
    leaves = (0.02, np.sqrt(0.2**2 - 0.02**2), 0)
    np.testing.assert_allclose(met.clamp[:2] @ met.clamp[:2], 0.2**2, rtol=0, atol=1e-8)
    np.testing.assert_allclose([left.clamp, met_next.clamp], [leaves] * 2, rtol=0, atol=1e-7)
    on = np.array([part(scan.point[scan.in_contact]) for part in there.parts[:2]])
    behind = scan.trail.position[scan.in_contact, 1] > leaves[1]
    np.testing.assert_allclose(np.where(behind, on[1], on[0]), 0, atol=1e-9)
    assert 0 < np.count_nonzero(behind) < behind.size


def small_part(rng: np.random.Generator) -> tuple[Place, vb.Scan]:
    """A ball or a block of 0.005 to 0.06 L beside the rod's way over a larger ball, at most 0.08 L
    from where the contact is at one position.
    """
    large = ((0.1, 0.1, 0.9), 0.3)
    alone = vb.scan(
        vb.Rod.unit(),
        place(0.05, large).surface,
        vb.Trail.line(start=(1.2, 0.05, 0), stop=(-1.2, 0.05, 0), count=COUNT),
    )
    row = rng.choice(np.flatnonzero(alone.in_contact & (alone.status == vb.Status.OK)))
    line = alone.elastic_line(int(row), POINTS)
    touching = int(np.argmin(np.linalg.norm(line - alone.point[row], axis=1)))
    beside = line[min(touching + int(rng.integers(-160, 160)), POINTS - 1)]
    size, away = rng.uniform(0.005, 0.06), rng.normal(size=3)
    center = tuple(beside + away / np.linalg.norm(away) * (size + rng.uniform(-0.006, 0.002)))
    there = (
        place(0.05, large, block=(center, (size,) * 3))
        if rng.random() < 0.5
        else place(0.05, large, (center, size))
    )
    return there, vb.scan(vb.Rod.unit(), there.surface, alone.trail)


@pytest.mark.parametrize("seed", range(10))
def test_small_parts_beside_a_contact_are_noticed(seed: int) -> None:
    """Far smaller than the points of the first look are apart: the distances from the parts say
    that a part may lie between.
    """
    there, scan = small_part(np.random.default_rng(seed))
    for i in np.flatnonzero(scan.in_contact):
        depth = -there.distances(scan.elastic_line(int(i), 2 * POINTS)).min()
        if scan.status[i] == vb.Status.OK:
            assert depth < 1e-6
        if scan.status[i] == vb.Status.PENETRATING:
            assert depth > 0


def test_a_tip_that_is_caught_between_two_parts_is_pushed_by_both() -> None:
    """In the crease of two balls, from where no single contact leads on: a rod in space, by the
    integral of its own equations, with its end on both balls.
    """
    one, other = (np.array([-0.3, 0.0, 1.15]), 0.45), (np.array([0.35, 0.1, 1.1]), 0.35)
    surface = Union([Sphere(*one), Sphere(*other)])
    scan = vb.scan(
        vb.Rod.unit(), surface, vb.Trail.line(start=(1.2, 0.0, 0), stop=(-1.2, 0.0, 0), count=41)
    )
    caught = np.flatnonzero(scan.status == vb.Status.PENETRATING)
    assert caught.size > 6
    for i in caught[::2]:
        np.testing.assert_allclose(scan.second_contact[i], scan.point[i], rtol=0, atol=1e-9)
        normals = [scan.point[i] - center for center, _ in (one, other)]
        np.testing.assert_allclose(
            [np.linalg.norm(n) for n in normals], [one[1], other[1]], rtol=0, atol=1e-9
        )
        force, moment = -scan.reactions.force[i], -scan.reactions.moment[i]
        shares = np.linalg.lstsq(np.stack(normals, axis=1), force, rcond=None)[0]
        np.testing.assert_allclose(np.stack(normals, axis=1) @ shares, force, rtol=0, atol=1e-9)
        assert np.all(shares > 0)
        rod = shooting.rod_along(
            scan.trail.position[i], (0, 0, 1), moment, force, np.linspace(0.01, 1.0, 400)
        )
        outside = np.min(
            [
                np.linalg.norm(rod[:, :3] - center, axis=1) - radius
                for center, radius in (one, other)
            ],
            axis=0,
        )
        assert outside.min() > -1e-6
        end = rod[-1]
        np.testing.assert_allclose(end[:3], scan.point[i], rtol=0, atol=1e-8)
        np.testing.assert_allclose(end[6:9], 0, atol=1e-8)


def test_a_rod_of_finite_radius_is_caught_with_its_skin_on_both_parts() -> None:
    rod, one, other = (
        vb.Rod(1.0, 1.0, radius=0.01),
        (np.array([-0.3, 0.0, 1.15]), 0.45),
        (np.array([0.35, 0.1, 1.1]), 0.35),
    )
    trail = vb.Trail.line(start=(1.2, 0.0, 0), stop=(-1.2, 0.0, 0), count=41)
    scan = vb.scan(rod, Union([Sphere(*one), Sphere(*other)]), trail, finite_radius=True)
    caught = np.flatnonzero(scan.status == vb.Status.PENETRATING)
    assert caught.size > 6
    for i in caught[::2]:
        distances = np.abs(
            [
                [np.linalg.norm(place - center) - radius for center, radius in (one, other)]
                for place in (scan.point[i], scan.second_contact[i])
            ]
        )
        assert sorted(np.argmin(distances, axis=1)) == [0, 1]
        np.testing.assert_allclose(distances.min(axis=1), 0, atol=1e-9)
        end = scan.elastic_line(int(i), 5)[-1]
        np.testing.assert_allclose(
            [np.linalg.norm(end - center) - radius for center, radius in (one, other)],
            0.01,
            rtol=0,
            atol=1e-8,
        )


def test_between_points_that_lie_differently_close_the_line_is_looked_at_where_it_is() -> None:
    """On a circle to third order; and where a tip touches, beyond which nothing is left, between
    the tip and the next point.
    """
    angles = np.array([[-3e-3, 0.0, 1e-3], [-1e-3, 0.0, 4e-3]])
    circle = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
    between = np.asarray(parabolas(*np.moveaxis(circle, 1, 0)))
    np.testing.assert_allclose(np.linalg.norm(between, axis=-1), 1.0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(between[[0, 16, -1]], np.moveaxis(circle, 1, 0), atol=1e-15)
    tip, following = np.zeros((1, 3)), np.array([[0.0, 0.0, -1e-3]])
    height = np.asarray(parabolas(tip + 1e-17, tip, following))[..., 2]
    assert np.all((height <= 1e-15) & (height >= -1e-3))
