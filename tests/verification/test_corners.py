"""Where a branch has a corner: tip and tangential contact meet there, or the object's curvature jumps."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import vibrissa as vb

RADIUS = 0.01
STIFFNESS = {"length": 1.0, "youngs_modulus": 4 / (np.pi * RADIUS**4)}
PLAIN = vb.Rod.cylinder(radius=RADIUS, **STIFFNESS)


def tapered(tip: float) -> vb.Rod:
    return vb.Rod.tapered(base_radius=RADIUS, tip_radius=tip * RADIUS, **STIFFNESS)


def trail(way: vb.Trail, count: int, first: float = 0.0, last: float = 1.0) -> vb.Trail:
    """Between two poses, or a part of it; position and orientation in proportion."""
    share = np.linspace(first, last, count)
    position = way.position[0] + share[:, None] * (way.position[1] - way.position[0])
    turn = Slerp([0, 1], Rotation.from_quat(way.orientation))
    return vb.Trail(position, turn(share).as_quat())


ALONG = vb.Trail(
    np.array([[0.5045281, 0.13569744, 0.08078182], [-0.44067415, 0.28065759, 0.05180606]]),
    np.tile([0.09483163, -0.07515118, 0.06492252, 0.9905273], (2, 1)),
)
TURNING = vb.Trail(
    np.array([[-0.44485092, -0.65366882, 0.07808839], [-0.07925896, 0.78669771, -0.08432]]),
    np.array(
        [
            [0.12742312, 0.0509483, -0.05125476, 0.98921209],
            [0.08510573, -0.14089057, 0.18644646, 0.96857864],
        ]
    ),
)


@pytest.mark.parametrize(
    ("tip", "torus", "way", "first", "kind"),
    [
        (
            0.25949,
            vb.surfaces.Torus(
                center=(0, 0, 1.19176562),
                axis=(-0.63468605, 0.57452925, -0.51680739),
                major_radius=0.21439807,
                minor_radius=0.03372508,
            ),
            ALONG,
            0.2,
            vb.EventKind.SNAP,
        ),
        (
            0.0500952,
            vb.surfaces.Torus(
                center=(0, 0, 1.02406869),
                axis=(-0.06370895, -0.18032756, -0.98154121),
                major_radius=0.36801758,
                minor_radius=0.14381103,
            ),
            TURNING,
            0.3,
            vb.EventKind.TIP_TO_TANGENTIAL,
        ),
    ],
)
def test_what_happens_at_a_corner_does_so_at_one_place_with_any_steps(
    tip: float, torus: vb.surfaces.Torus, way: vb.Trail, first: float, kind: vb.EventKind
) -> None:
    """A contact that runs off the tip, where the branch turns back, and one that moves onto the rod of
    a thin tip, whose conditions rounding leaves at 1e-10.
    """
    places = []
    for count, begin, end in ((61, 0.0, 1.0), (241, 0.0, 1.0), (241, first, first + 0.5)):
        scan = vb.scan(tapered(tip), torus, trail(way, count, begin, end))
        (event,) = (event for event in scan.events if event.kind == kind)
        places.append(begin + event.parameter * (end - begin))
    assert np.ptp(places) < 1e-8


def test_what_would_change_at_a_branch_s_end_is_no_event() -> None:
    """Contacts that run off the tip, and onto it: where rounding has the steps end, the determinant
    or the phase may have changed.
    """
    torus = vb.surfaces.Torus(
        center=(0, 0, 0.9456908),
        axis=(-0.5368263, -0.7001215, -0.4707945),
        major_radius=0.217617,
        minor_radius=0.114813,
    )
    way = vb.Trail(
        np.array([[-0.4650809, -0.478727, 0.026363], [0.6313599, 0.2164822, -0.2207153]]),
        np.tile([-0.0718243, 0.0809628, 0.0252364, 0.9938055], (2, 1)),
    )
    for count in (61, 101, 241, 961):
        events = vb.scan(PLAIN, torus, trail(way, count)).events
        assert [event.kind.name for event in events] == ["FIRST_CONTACT", "SNAP", "SNAP"]
        places = [event.parameter for event in events]
        np.testing.assert_allclose(places, [0.342141, 0.363699, 0.656519], rtol=0, atol=1e-6)
    # How near the end counts is a length, not a fraction of a step.
    events = vb.scan(PLAIN, torus, trail(way, 3001)).events
    assert [event.kind.name for event in events if event.parameter > 0.5] == ["SNAP"]


def test_a_snap_is_not_ahead_of_its_place() -> None:
    """Trails that end short of a fold by up to a thousandth: nothing has snapped yet."""
    egg = vb.surfaces.Ellipsoid(center=(0, 0, 0.939049), semi_axes=(0.042565, 0.067384, 0.397677))
    turn = Rotation.from_rotvec([0.160254, -0.066954, -0.070145]).as_quat()
    ends = np.array([[-0.887193, -0.127475, -0.064689], [0.856923, 0.262764, 0.249155]])
    way = vb.Trail(ends, np.tile(turn, (2, 1)))
    fold = next(
        event.parameter
        for event in vb.scan(PLAIN, egg, trail(way, 101)).events
        if event.kind == vb.EventKind.SNAP
    )
    short = np.array([2e-5, 5e-5, 1e-4, 2e-4, 1e-3])
    scan = vb.scan(PLAIN, egg, vb.Trail.stack([trail(way, 16, last=fold - by) for by in short]))
    assert [event.kind.name for event in scan.events] == ["FIRST_CONTACT"] * len(short)
    # A snap moves the point by more; near a fold it moves as the root of the distance from it, and
    # by a term of the next order: 2 % here.
    moved = np.linalg.norm(scan.point[1:, -1] - scan.point[0, -1], axis=1)
    assert np.all(np.diff(moved) > 0)
    assert moved[-1] < 0.1
    root = np.sqrt(short[1:]) - np.sqrt(short[0])
    np.testing.assert_allclose(moved / root, moved[0] / root[0], rtol=0.03)


def test_a_branch_goes_on_past_an_edge_where_it_turns_by_more_than_a_right_angle() -> None:
    """A box's edges, rounded by the rod's radius, meet its faces where the curvature jumps."""
    box = vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.37145469, 0.26465183, 0.18360264))
    turned = box.placed((-0.44688162, -0.45590204, -0.25206318, 0.72726495), (0, 0, 0.80956077))
    way = vb.Trail(
        np.array([[-0.13236793, -0.73272397, 0.08474175], [-0.01104568, 0.7445023, 0.09302319]]),
        np.array(
            [
                [-0.06944086, -0.02954961, 0.17680729, 0.98134804],
                [0.21050729, -0.013913, 0.35003207, 0.91267226],
            ]
        ),
    )
    few, many = (
        vb.scan(PLAIN, turned, trail(way, count), finite_radius=True) for count in (61, 241)
    )
    np.testing.assert_allclose(few.point, many.point[::4], rtol=0, atol=1e-8)
    kinds = [[event.kind for event in scan.events] for scan in (few, many)]
    assert kinds[0] == kinds[1]


def test_a_tip_contact_of_a_rod_of_no_taper_lies_as_deep_as_the_closed_form_has_it() -> None:
    """Its arc length is the rod's to rounding, on either side of it: nothing lies behind."""
    torus = vb.surfaces.Torus(
        center=(0, 0, 0.94165834),
        axis=(-0.86347892, -0.16370138, 0.47708072),
        major_radius=0.27682732,
        minor_radius=0.11593166,
    )
    way = vb.Trail(
        np.array([[-0.48325192, 0.29248253, -0.07554121], [0.42776575, -0.36891047, -0.02368111]]),
        np.array(
            [
                [0.13499925, 0.0435484, -0.14379174, 0.97938893],
                [0.07122769, 0.1196467, -0.26656949, 0.95370435],
            ]
        ),
    )
    scan, plain = (vb.scan(rod, torus, trail(way, 201)) for rod in (tapered(1 - 1e-10), PLAIN))
    np.testing.assert_array_equal(scan.status, plain.status)
    np.testing.assert_allclose(scan.depth, plain.depth, rtol=0, atol=1e-6)


class PastABox(NamedTuple):
    """A rod that slides along the edges of a box, which its radius rounds."""

    half_extents: list[float]
    turn: list[float]
    """The box's, about its centre (0, 0, height)."""
    height: float
    ends: list[list[float]]
    """Positions at both."""
    axes: list[list[float]]

    def told(
        self,
        count: int,
        *,
        rod: vb.Rod = PLAIN,
        turn: Rotation | None = None,
        roll: float = 0.0,
        mirrored: bool = False,
    ) -> tuple[list[str], list[float]]:
        """Names and places of events, in a scene turned about the origin and moved, with its clamp
        rolled, or mirrored at the plane y = 0.
        """
        turn, shift = turn or Rotation.identity(), np.array([0.3, -0.2, 0.5])
        flip, mirror = ([-1, 1, -1, 1], [1, -1, 1]) if mirrored else ([1, 1, 1, 1], [1, 1, 1])
        box = vb.surfaces.Box(center=(0, 0, 0), half_extents=self.half_extents)
        box = box.placed(np.multiply(self.turn, flip), (0, 0, self.height))
        way = trail(vb.Trail(np.multiply(self.ends, mirror), np.multiply(self.axes, flip)), count)
        axes = turn * Rotation.from_quat(way.orientation) * Rotation.from_rotvec([0, 0, roll])
        scan = vb.scan(
            rod,
            box.placed(turn.as_quat(), shift),
            vb.Trail(turn.apply(way.position) + shift, axes.as_quat()),
            finite_radius=True,
        )
        names = [event.kind.name for event in scan.events]
        return names, [event.parameter for event in scan.events]


SMALL_SNAP = PastABox(
    [0.37985442, 0.15749843, 0.13921732],
    [0.67093837, -0.65753851, 0.18320089, -0.28969337],
    1.11448169,
    [[0.55494693, -0.21995585, 0.16308259], [-0.4907708, 0.33983922, 0.15920801]],
    [
        [-0.17151702, 0.04408234, 0.13964373, 0.97423728],
        [0.11208507, 0.01456002, -0.08319768, 0.99010257],
    ],
)
SOON_AFTER = PastABox(
    [0.39917356, 0.34917578, 0.12619024],
    [-0.03159998, -0.07616499, 0.56656981, 0.81987742],
    0.96343559,
    [[-0.3720243, 0.2256113, 0.10476982], [0.4344099, -0.02430182, -0.0151824]],
    [[-0.02169107, -0.15287169, 0.18249105, 0.97100812]] * 2,
)
TWO_TO_SNAP_TO = PastABox(
    [0.39384275, 0.06414005, 0.09297534],
    [-0.39409327, -0.67129806, 0.11915982, 0.61632],
    1.18577692,
    [[0.24194697, -0.30144097, 0.1321333], [-0.08584195, 0.37687684, -0.00189123]],
    [[-0.01825061, -0.10557208, -0.161935, 0.98096815]] * 2,
)
DEEP_BELOW = PastABox(
    [0.29581831, 0.26129818, 0.24045917],
    [0.909993, -0.14000557, -0.35991224, -0.15091174],
    0.80030871,
    [[-0.00483803, -0.47285194, 0.13765779], [0.18442945, 0.43542869, 0.11259774]],
    [[0.03150601, -0.04588743, -0.25715597, 0.96476553]] * 2,
)


@pytest.mark.parametrize("scene", [SMALL_SNAP, SOON_AFTER])
def test_a_tip_that_snaps_along_an_edge_does_so_with_any_steps(scene: PastABox) -> None:
    """By 0.01 L, hardly farther than it moves before, and by 0.06 L just after a change of phase."""
    names, places = scene.told(1281)
    assert names == ["FIRST_CONTACT", "TANGENTIAL_TO_TIP", "SNAP"]
    for count in (21, 41, 161, 641):
        found, where = scene.told(count)
        assert found == names
        np.testing.assert_allclose(where, places, rtol=0, atol=1e-8)


@pytest.mark.parametrize("scene", [TWO_TO_SNAP_TO, DEEP_BELOW])
def test_a_rod_snaps_to_the_same_place_in_any_view(scene: PastABox) -> None:
    """There are several equilibria to snap to."""
    names, places = scene.told(41)
    assert "SNAP" in names[:-1]
    turns = Rotation.random(4, random_state=3)
    for turn, roll, mirrored in zip(turns, (0.0, 1.1, 4.0, 0.0), (False, True) * 2, strict=True):
        found, where = scene.told(41, turn=turn, roll=roll, mirrored=mirrored)
        assert found == names
        np.testing.assert_allclose(where, places, rtol=0, atol=1e-7)


PAST_A_CORNER = PastABox(
    [0.07997721, 0.13288368, 0.33044606],
    [-0.5572357, -0.28853744, 0.21412314, 0.74858921],
    0.83765146,
    [[0.37133178, -0.38128983, 0.03137635], [-0.47635491, 0.23739256, 0.0787734]],
    [
        [0.05481847, 0.11499135, -0.22319602, 0.96641372],
        [0.08184371, -0.01768799, -0.10133922, 0.9913219],
    ],
)
ON_TO_A_CORNER = PastABox(
    [0.34814188, 0.35971253, 0.31799798],
    [-0.13424625, -0.66064953, -0.08605318, -0.73356322],
    0.82007989,
    [[-0.62829062, 0.19202761, 0.20829423], [0.65548727, 0.04427364, 0.1662927]],
    [[-0.04189236, -0.04931348, -0.04853762, 0.99672329]] * 2,
)


@pytest.mark.parametrize(
    ("scene", "tip", "curvature", "roll", "happened"),
    [
        (PAST_A_CORNER, 0.40158061, -0.02513844, 0.95843349, ["FIRST_CONTACT", "SNAP"]),
        (
            ON_TO_A_CORNER,
            0.33984527,
            0.45120453,
            5.70527706,
            ["FIRST_CONTACT", "TIP_TO_TANGENTIAL"],
        ),
    ],
)
def test_a_rod_moves_on_over_the_corner_of_a_box_in_any_view(
    scene: PastABox, tip: float, curvature: float, roll: float, happened: list[str]
) -> None:
    """Where the contact passes from an edge onto a corner and on within 1e-6 L, the determinant of
    either differs by orders of magnitude, and in sign. Neither snaps there.
    """
    rod = tapered(tip).curved(vb.RestShape.parabola(curvature, roll=roll))
    names, places = scene.told(41, rod=rod)
    assert names[:2] == happened
    turns = [*Rotation.random(3, random_state=3), *Rotation.random(3, random_state=28)]
    for turn in turns:
        found, where = scene.told(41, rod=rod, turn=turn)
        assert found == names
        np.testing.assert_allclose(where, places, rtol=0, atol=1e-6)


ONTO_ITS_TIP = PastABox(
    [0.05389445, 0.30161873, 0.16589452],
    [0.22462063, -0.66476687, 0.24910383, -0.66751619],
    0.84192991,
    [[-0.59479151, 0.12439929, 0.15455002], [0.59830185, 0.10624041, 0.05062739]],
    [
        [0.12798334, 0.03414918, 0.05648327, 0.98957756],
        [-0.0532046, 0.14398246, 0.08917338, 0.98411708],
    ],
)


def test_a_change_of_phase_is_where_the_contact_reaches_the_tip() -> None:
    """Where a determinant is a hundredth of that on the other side: no line between two positions
    tells the place.
    """
    rod = tapered(0.584587).curved(vb.RestShape.parabola(0.38310471, roll=4.14940146))
    for count in (21, 41, 161, 641):
        for turn in (Rotation.identity(), *Rotation.random(3, random_state=53)):
            names, places = ONTO_ITS_TIP.told(count, rod=rod, turn=turn)
            assert names[:3] == ["FIRST_CONTACT", "TANGENTIAL_TO_TIP", "SNAP"]
            assert abs(places[1] - 0.571398) < 1e-6
