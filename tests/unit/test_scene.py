"""A scan played in time, against the scan itself; and what a sensor logs of it, read back."""

from itertools import islice

import numpy as np
import pytest

import vibrissa as vb
from vibrissa.live.scene import measured, motion, swept
from vibrissa.sensor import RawRecording
from vibrissa.trail import between, linear

TRAIL = vb.Trail.line(start=(1.0, 0.2, 0), stop=(-1.0, 0.2, 0), count=11)


def test_reactions_over_time_are_those_of_the_scan() -> None:
    """At times between the positions of the case too: there the scan is made anew, in one call."""
    rod, surface = vb.Rod.unit(), vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
    scene = swept(rod, surface, TRAIL, rest=0.5, sweep=2.0)
    time = np.array([0.0, 0.3, *(0.5 + np.linspace(0, 2, 4001)[123:4000:31]), 2.6, 9.0])
    assert scene.time is not None
    position = between(scene.time, scene.trail, time).position
    force, moment = (linear(scene.time, part, time) for part in (scene.force, scene.moment))
    expected = vb.scan(
        rod, surface, vb.Trail(np.outer(1 - (time[2:-2] - 0.5), [1, 0, 0]) + [0, 0.2, 0])
    )
    np.testing.assert_allclose(position[2:-2], expected.trail.position, atol=1e-12)
    np.testing.assert_allclose(force[2:-2], expected.reactions.force, atol=2e-4)
    np.testing.assert_allclose(moment[2:-2], expected.reactions.moment, atol=2e-4)
    assert np.linalg.norm(expected.reactions.force, axis=1).max() > 1
    ends = vb.scan(rod, surface, TRAIL).reactions.force[[0, 0, -1, -1]]
    np.testing.assert_allclose(force[[0, 1, -2, -1]], ends, atol=1e-10)
    np.testing.assert_allclose(
        position[[0, 1, -1]], [[1, 0.2, 0], [1, 0.2, 0], [-1, 0.2, 0]], atol=1e-12
    )


def test_several_trails_follow_each_other() -> None:
    both = vb.Trail.stack(
        [TRAIL, vb.Trail.line(start=(1.0, 0.4, 0), stop=(-1.0, 0.4, 0), count=11)]
    )
    time, clamp = motion(both, rest=1.0, sweep=2.0, pause=0.5)
    position = clamp.position
    assert np.all(np.diff(time) > 0)
    assert (time[0], time[10], time[11], time[-1]) == (1.0, 3.0, 3.5, 5.5)
    np.testing.assert_allclose(position[[0, 10, 11, 21], 1], [0.2, 0.2, 0.4, 0.4])


def scene_of_nothing() -> vb.Reactions:
    """The motion of the trail, free of contact."""
    time, clamp = motion(TRAIL, rest=0.0, sweep=2.0, pause=1.0)
    moment = np.outer(time, [1.0, 2.0, 3.0])
    return vb.Reactions(clamp, np.zeros_like(clamp.position), moment, time=time)


def sensor() -> vb.Sensor:
    return vb.Sensor(
        np.array([0.01, 0.02, 0.03]),
        np.array([0.0, 0.6, 0.0, 0.8]),
        "on_sensor",
        wrench_point=(0, 0, 0.001),
    )


def test_the_sensor_s_log_read_back_is_the_scene() -> None:
    """Block after block, and again from the start where the scene is repeated: samples are evenly
    spaced, poses those of the sensor.
    """
    scene, tare = scene_of_nothing(), np.array([1.0, 2, 3, 4, 5, 6])
    blocks = list(
        islice(
            measured(
                scene, sensor(), 100.0, np.random.default_rng(0), tare=tare, block=64, repeat=True
            ),
            9,
        )
    )
    raw = RawRecording(
        *(
            np.concatenate([getattr(block, name) for block in blocks])
            for name in ("time", "position", "orientation", "force", "torque")
        )
    )
    np.testing.assert_allclose(np.diff(raw.time), 0.01, atol=1e-12)
    again = sensor().reactions(
        RawRecording(
            raw.time, raw.position, raw.orientation, raw.force - tare[:3], raw.torque - tare[3:]
        )
    )
    within = np.mod(raw.time, 2.0)
    np.testing.assert_allclose(again.moment, np.outer(within, [1.0, 2.0, 3.0]), atol=1e-12)
    np.testing.assert_allclose(again.trail.position[:, 0], 1 - within, atol=1e-12)
    first = blocks[0]
    rows = slice(len(first.time))
    clamp = vb.Trail(again.trail.position[rows], again.trail.orientation[rows])
    poses = sensor().frame(clamp)
    np.testing.assert_allclose(poses.position, first.position, atol=1e-12)
    np.testing.assert_allclose(poses.orientation, first.orientation, atol=1e-12)


@pytest.mark.parametrize(("name", "value"), [("rest", -1.0), ("sweep", 0.0), ("pause", np.inf)])
def test_times_that_are_none(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        motion(TRAIL, **{"rest": 1.0, "sweep": 1.0, "pause": 1.0, name: value})
