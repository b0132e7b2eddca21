"""A scan played over time, as a sensor would feel it."""

from collections.abc import Iterator
from itertools import count

import numpy as np
from jaxtyping import Float

from vibrissa.forward import scan
from vibrissa.geometry.checks import not_negative, positive
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor import RawRecording, Sensor
from vibrissa.surfaces import Surface
from vibrissa.trail import Trail, between, linear

_MOST_POSITIONS = 4001  # of a scan: steps of 10 µm over 40 mm; reactions are linear between


def swept(
    rod: Rod,
    surface: Surface,
    trail: Trail,
    *,
    rest: float,
    sweep: float,
    pause: float = 0.5,
    friction: float = 0.0,
    finite_radius: bool = False,
) -> Reactions:
    """Reactions (k, …) of a case over time: along the first trail, then on to the next one.

    Parameters
    ----------
    rod, surface, trail, friction, finite_radius
        As for `vibrissa.scan`, in SI units.
    rest, sweep, pause
        As for `motion`. Reactions are interpolated between trails: zero if their ends are free of
        contact.

    Raises
    ------
    ValueError
        If a time is not allowed, or a trail has less than two positions.
    """
    fine = _refined(trail)
    time, clamp = motion(fine, rest=rest, sweep=sweep, pause=pause)
    felt = scan(rod, surface, fine, friction=friction, finite_radius=finite_radius).reactions
    force, moment = (np.nan_to_num(part).reshape(-1, 3) for part in (felt.force, felt.moment))
    return Reactions(clamp, force, moment, time=time)


def motion(
    trail: Trail, *, rest: float, sweep: float, pause: float
) -> tuple[Float[np.ndarray, "k"], Trail]:
    """Time (k,) [s] and clamp poses (k, …) of trails swept one after the other.

    Parameters
    ----------
    trail
        One or several.
    rest
        Seconds before anything moves, for the tare.
    sweep
        Seconds for each trail.
    pause
        Seconds for the straight move from one trail's end to the start of the next.

    Raises
    ------
    ValueError
        If a time is not allowed, or a trail has fewer than two positions.
    """
    not_negative(rest, "rest")
    positive(sweep, "sweep")
    positive(pause, "pause")
    if trail.count < 2:
        raise ValueError(f"trail has {trail.count} positions; allowed are at least 2")
    clamp = Trail(trail.position.reshape(-1, 3), trail.orientation.reshape(-1, 4))
    start = rest + (sweep + pause) * np.arange(clamp.count // trail.count)
    return np.add.outer(start, np.linspace(0.0, sweep, trail.count)).ravel(), clamp


def _refined(trail: Trail) -> Trail:
    """The same motion in more steps, so that reactions may be taken as linear between them."""
    steps = max(trail.count - 1, 1)
    wanted = np.linspace(0, steps, max((_MOST_POSITIONS - 1) // steps, 1) * steps + 1)
    several = trail if trail.position.ndim == 3 else Trail.stack([trail])
    given = np.arange(float(trail.count))
    lanes = range(len(several.position))
    return Trail.stack([between(given, several[lane], wanted) for lane in lanes])


def measured(
    scene: Reactions,
    sensor: Sensor,
    rate: float,
    rng: np.random.Generator,
    *,
    tare: Float[np.ndarray, "6"],
    block: int = 512,
    repeat: bool = False,
) -> Iterator[RawRecording]:
    """What the sensor logs of a scene, in an endless series of blocks of rows: sample i at i/rate.
    The clamp stands still before and after the scene, or `repeat` plays it again and again.
    """
    assert scene.time is not None
    duration = scene.time[-1] if repeat else np.inf
    for first in count(0, block):
        time = np.arange(first, first + block) / rate
        parts = (scene.force, scene.moment)
        force, moment = (linear(scene.time, part, time % duration) for part in parts)
        felt = Reactions(between(scene.time, scene.trail, time % duration), force, moment, time)
        yield sensor.measure(felt, rng, force_tare=tare[:3], torque_tare=tare[3:])
