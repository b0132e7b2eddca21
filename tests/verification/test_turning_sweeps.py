"""Sweeps of a clamp that turns: what a rigid motion of everything, or of the object the other way,
leaves as it is; and events at exact angles.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb

UNIT = vb.Rod.unit()
CLOSE = 1e-10


class Placed(NamedTuple):
    """An object, turned and then moved: all but planes, which are planes again, are placed once, so
    that few kernels are compiled.
    """

    own: vb.surfaces.Surface
    rotation: Rotation = Rotation.identity()
    translation: np.ndarray = np.zeros(3)

    @property
    def surface(self) -> vb.surfaces.Surface:
        """For the package."""
        return self.moved(Rotation.identity(), np.zeros(3))

    def moved(self, rotation: Rotation, translation: np.ndarray) -> vb.surfaces.Surface:
        """The same, turned and moved once more."""
        turn, shift = rotation * self.rotation, rotation.apply(self.translation) + translation
        if isinstance(self.own, vb.surfaces.Plane):
            return vb.surfaces.Plane(
                turn.apply(self.own.point) + shift, turn.apply(self.own.outward)
            )
        return self.own.placed(turn, shift)


def ball(center: tuple[float, float, float], radius: float) -> Placed:
    return Placed(vb.surfaces.Ellipsoid(center=center, semi_axes=(radius, radius, radius)))


TURN = Rotation.from_quat((0.1, 0.2, 0.0, 1.0))
EGG = Placed(
    vb.surfaces.Ellipsoid(center=(0.0, 0.0, 0.0), semi_axes=(0.5, 0.4, 0.3)),
    TURN,
    np.array([0.1, 0.1, 1.05]),
)
WALL = Placed(vb.surfaces.Plane(point=(-0.5, 0.0, 0.0), normal=(1.0, 0.3, 0.1)))

BEHIND = {
    "pivot": (0.0, 0.2, -0.5),
    "axis": (0.0, -1.0, 0.0),
    "position": (0.0, 0.2, 0.0),
    "start_angle": -1.0,
    "stop_angle": 1.0,
}
OBLIQUE = {
    "pivot": (0.0, 0.0, 0.0),
    "axis": (0.2, -1.0, 0.1),
    "position": (0.05, 0.0, 0.1),
    "start_angle": 0.9,
    "stop_angle": -0.9,
}
AT_THE_CLAMP = {
    "pivot": (0.0, 0.0, 0.0),
    "axis": (0.0, -1.0, 0.1),
    "position": (0.0, 0.0, 0.0),
    "start_angle": -0.2,
    "stop_angle": 1.1,
}
SCENES = {
    "ball": (ball((0.0, 0.1, 1.1), 0.5), OBLIQUE, (0.1, 0.0, 1.0)),
    "egg": (EGG, BEHIND, (0.0, 0.1, 1.0)),
    "wall": (WALL, AT_THE_CLAMP, (0.0, 0.2, 1.0)),
}


def whisked(name: str, count: int = 81) -> tuple[vb.Scan, Rotation]:
    """A whisking sweep through contact, sound throughout, and the clamp's rotations."""
    surface, motion, rod_axis = SCENES[name]
    scan = vb.scan(UNIT, surface.surface, vb.Trail.whisk(**motion, count=count, rod_axis=rod_axis))
    assert np.count_nonzero(scan.in_contact) > count // 6
    assert np.all(scan.status == vb.Status.OK)
    return scan, Rotation.from_quat(scan.trail.orientation)


@pytest.mark.parametrize("name", SCENES)
def test_the_object_moved_the_other_way_gives_the_same_in_the_clamps_frame(name: str) -> None:
    """The object where the turned clamp sees it, and a clamp that is pushed straight to where it
    is: each position by itself, reached without turning.
    """
    scan, turns = whisked(name)
    for i in np.flatnonzero(scan.in_contact)[::6]:
        back = turns[i].inv()
        seen = SCENES[name][0].moved(back, -back.apply(scan.trail.position[i]))
        still = vb.scan(UNIT, seen, vb.Trail([(0, 0, -0.02), (0, 0, 0)]))
        assert still.kind[-1] == scan.kind[i]
        np.testing.assert_allclose(
            still.reactions.force[-1], back.apply(scan.reactions.force[i]), rtol=0, atol=CLOSE
        )
        np.testing.assert_allclose(
            still.reactions.moment[-1], back.apply(scan.reactions.moment[i]), rtol=0, atol=CLOSE
        )
        np.testing.assert_allclose(
            still.point[-1], back.apply(scan.point[i] - scan.trail.position[i]), rtol=0, atol=CLOSE
        )
        np.testing.assert_allclose(still.arc_length[-1], scan.arc_length[i], rtol=0, atol=CLOSE)


@pytest.mark.parametrize("name", SCENES)
def test_a_whole_scene_turned_gives_turned_results(name: str) -> None:
    scan, turns = whisked(name)
    surface, motion, _ = SCENES[name]
    turn, shift = Rotation.from_rotvec([0.7, -1.1, 0.4]), np.array([0.3, -2.0, 0.8])
    pivot, position = (turn.apply(motion[key]) + shift for key in ("pivot", "position"))
    zero = (
        Rotation.from_rotvec(
            -motion["start_angle"] * np.array(motion["axis"]) / np.linalg.norm(motion["axis"])
        )
        * turns[0]
    )
    moved = {
        **motion,
        "pivot": pivot,
        "axis": turn.apply(motion["axis"]),
        "position": position,
        "orientation": turn * zero,
    }
    other = vb.scan(
        UNIT, surface.moved(turn, shift), vb.Trail.whisk(**moved, count=scan.trail.count)
    )
    np.testing.assert_array_equal(other.kind, scan.kind)
    np.testing.assert_allclose(
        other.trail.position, turn.apply(scan.trail.position) + shift, rtol=0, atol=1e-14
    )
    for ours, theirs in (
        (other.reactions.force, turn.apply(scan.reactions.force)),
        (other.reactions.moment, turn.apply(scan.reactions.moment)),
        (other.normal, turn.apply(scan.normal)),
        (other.point, turn.apply(scan.point) + shift),
        (other.energy, scan.energy),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=CLOSE)
    assert [event.kind for event in other.events] == [event.kind for event in scan.events]
    for ours, theirs in zip(other.events, scan.events, strict=True):
        assert ours.parameter == pytest.approx(theirs.parameter, abs=1e-9)
        np.testing.assert_allclose(ours.clamp, turn.apply(theirs.clamp) + shift, rtol=0, atol=1e-9)
        np.testing.assert_allclose(ours.point, turn.apply(theirs.point) + shift, rtol=0, atol=1e-8)


def test_few_positions_of_a_turning_clamp_are_those_of_many() -> None:
    """The clamp on its pivot axis: between two poses it is where the finer trail has it, and events
    are at the same angles.
    """
    few, many = whisked("wall", 14)[0], whisked("wall", 131)[0]
    np.testing.assert_array_equal(few.kind, many.kind[::10])
    np.testing.assert_allclose(
        few.reactions.moment, many.reactions.moment[::10], rtol=0, atol=CLOSE
    )
    assert [event.kind for event in few.events] == [event.kind for event in many.events]
    for coarse, fine in zip(few.events, many.events, strict=True):
        assert coarse.parameter == pytest.approx(fine.parameter, abs=1e-9)
        np.testing.assert_allclose(coarse.point, fine.point, rtol=0, atol=1e-8)


def first_angle(
    reach: float, behind: float, count: int, distance: float, radius: float
) -> tuple[float, np.ndarray]:
    """Angle before the ball's centre at which a rod of unit length, radial from its pivot, meets a
    ball on the z axis; and where.
    """
    motion = {
        "pivot": (0.0, 0.0, 0.0),
        "axis": (0.0, 1.0, 0.0),
        "start_angle": -1.2,
        "stop_angle": 0.3,
    }
    trail = vb.Trail.whisk(**motion, position=(0.0, 0.0, behind), count=count)
    scan = vb.scan(UNIT, ball((0.0, 0.0, distance), radius).surface, trail)
    event = scan.events[0]
    assert event.kind == vb.EventKind.FIRST_CONTACT
    assert np.linalg.norm(event.point) == pytest.approx(reach, abs=1e-3)
    return -1.2 + 1.5 * event.parameter, event.point


def test_first_contact_with_the_tip_is_at_the_exact_angle() -> None:
    """Law of cosines: pivot at the clamp, the tip at a distance 1, the ball's centre at 1.1."""
    angle, point = first_angle(1.0, 0.0, 31, 1.1, 0.3)
    exact = -np.arccos((1.1**2 + 1 - 0.3**2) / (2 * 1.1))
    assert angle == pytest.approx(exact, abs=1e-9)
    np.testing.assert_allclose(point, [np.sin(exact), 0, np.cos(exact)], rtol=0, atol=1e-8)


def test_first_contact_with_the_flank_is_at_the_exact_angle() -> None:
    """The rod's line touches the ball where the pivot's tangent does."""
    reach = np.sqrt(0.8**2 - 0.3**2)
    angle, point = first_angle(reach, 0.0, 31, 0.8, 0.3)
    assert angle == pytest.approx(-np.arcsin(0.3 / 0.8), abs=1e-9)
    np.testing.assert_allclose(
        point, reach * np.array([np.sin(angle), 0, np.cos(angle)]), rtol=0, atol=1e-8
    )


def test_between_positions_on_an_arc_the_clamp_moves_along_the_chord() -> None:
    """With the clamp off its pivot, events come to their exact angles with the square of the step:
    its chords leave the arc by as much.
    """
    exact = -np.arccos((1.6**2 + 1.5**2 - 0.3**2) / (2 * 1.6 * 1.5))
    counts = np.array([16, 61, 241])
    errors = np.abs([first_angle(1.5, 0.5, int(count), 1.6, 0.3)[0] - exact for count in counts])
    steps = 1.5 / (counts - 1)
    assert np.all(errors < steps**2)
    assert errors[-1] < 1e-5


def test_round_a_ball_nothing_changes_but_the_direction() -> None:
    """An arc about the ball's axis, the clamp turning with it: in the clamp's frame every position
    is the first.
    """
    arc = vb.Trail.arc(
        center=(0, 0, 0),
        axis=(0, 0, 1),
        start=(0.3, 0, 0),
        angle=2.5,
        count=26,
        turning=True,
        rod_axis=(-0.2, 0.1, 1.0),
    )
    scan = vb.scan(UNIT, ball((0.0, 0.0, 1.05), 0.5).surface, arc)
    assert np.all(scan.status == vb.Status.OK)
    assert [event.kind for event in scan.events] == [vb.EventKind.STARTED_IN_CONTACT]
    turns = Rotation.from_rotvec(np.outer(np.linspace(0, 2.5, 26), [0, 0, 1]))
    for field in (scan.point, scan.reactions.force, scan.reactions.moment):
        np.testing.assert_allclose(
            turns.inv().apply(field), np.broadcast_to(field[0], (26, 3)), rtol=0, atol=CLOSE
        )
    np.testing.assert_allclose(scan.energy, scan.energy[0], rtol=0, atol=CLOSE)


def test_a_clamp_that_turns_in_place_and_then_moves_has_its_events_in_order() -> None:
    """Where it only turns its path has no length, and the parameter counts steps."""
    turning = vb.Trail.whisk(
        pivot=(0, 0, 0),
        axis=(0, 1, 0),
        position=(0, 0, 0),
        start_angle=-0.9,
        stop_angle=0.0,
        count=31,
    )
    line = vb.Trail.line(start=(0, 0, 0), stop=(1.5, 0, 0), count=31)
    join = (
        np.vstack([turning.position, line.position[1:]]),
        np.vstack([turning.orientation, line.orientation[1:]]),
    )
    scan = vb.scan(UNIT, ball((0.05, 0.15, 0.8), 0.3).surface, vb.Trail(*join))
    assert np.all(np.diff(scan.trail.parameter) > 0)
    kinds = [event.kind for event in scan.events]
    assert (kinds[0], kinds[-1]) == (vb.EventKind.FIRST_CONTACT, vb.EventKind.DETACH)
    assert scan.events[0].parameter < 0.5 < scan.events[-1].parameter
    assert [event.parameter for event in scan.events] == sorted(
        event.parameter for event in scan.events
    )
