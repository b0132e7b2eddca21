"""A scan played in time, as a sensor would feel it."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from vibrissa.forward import scan
from vibrissa.geometry.checks import not_negative, positive
from vibrissa.live.poses import between
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor import RawRecording, Sensor
from vibrissa.surfaces import Surface
from vibrissa.trail import Trail

_MOST_POSITIONS = 4001


@dataclass(frozen=True, eq=False)
class Scene:
    """Reactions at the clamp over time: at rest before the first trail, along it, then on to the
    next one.

    Attributes
    ----------
    time
        (k,) [s], increasing, from 0.
    position, orientation
        Of the clamp, (k, 3) and (k, 4).
    force, moment
        (k, 3) on the rod, world axes.
    """

    time: Float[np.ndarray, "k"]
    position: Float[np.ndarray, "k 3"]
    orientation: Float[np.ndarray, "k 4"]
    force: Float[np.ndarray, "k 3"]
    moment: Float[np.ndarray, "k 3"]

    @property
    def duration(self) -> float:
        """Seconds until the last trail has been swept."""
        return float(self.time[-1])

    def reactions(self, time: Float[np.ndarray, "n"]) -> Reactions:
        """Reactions (n, …) at these times [s], increasing; after the end, the clamp stands."""
        position, orientation = between(self.time, self.position, self.orientation, time)
        force, moment = (
            np.stack([np.interp(time, self.time, part[:, axis]) for axis in range(3)], axis=1)
            for part in (self.force, self.moment)
        )
        return Reactions(Trail(position, orientation), force, moment, time=time)


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
) -> Scene:
    """Scene of a case.

    Parameters
    ----------
    rod, surface, trail, friction, finite_radius
        As for `vibrissa.scan`, in SI units.
    rest
        Seconds at the start before anything moves: the tare's.
    sweep
        Seconds for each trail.
    pause
        Seconds from one trail's end to the next one's start: straight, and with reactions that go
        over evenly, none if the ends are free of contact.

    Raises
    ------
    ValueError
        If a time is not allowed, or a trail has less than two positions.
    """
    fine = _refined(trail)
    time, position, orientation = motion(fine, rest=rest, sweep=sweep, pause=pause)
    result = scan(rod, surface, fine, friction=friction, finite_radius=finite_radius)
    force, moment = (
        np.nan_to_num(part).reshape(-1, 3)
        for part in (result.reactions.force, result.reactions.moment)
    )
    if rest:
        force, moment = (np.concatenate([part[:1], part]) for part in (force, moment))
    return Scene(time, position, orientation, force, moment)


def motion(
    trail: Trail, *, rest: float, sweep: float, pause: float
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k 3"], Float[np.ndarray, "k 4"]]:
    """Time (k,) [s] and clamp poses (k, …) of trails that are swept one after the other; arguments
    and errors as for `swept`.
    """
    not_negative(rest, "rest")
    positive(sweep, "sweep")
    positive(pause, "pause")
    if trail.count < 2:
        raise ValueError(f"trail has {trail.count} positions; allowed are at least 2")
    position, orientation = trail.position.reshape(-1, 3), trail.orientation.reshape(-1, 4)
    lanes = len(position) // trail.count
    time = np.concatenate(
        [
            rest + lane * (sweep + pause) + np.linspace(0.0, sweep, trail.count)
            for lane in range(lanes)
        ]
    )
    if not rest:
        return time, position, orientation
    return (
        np.concatenate([[0.0], time]),
        np.concatenate([position[:1], position]),
        np.concatenate([orientation[:1], orientation]),
    )


def sensor_poses(
    sensor: Sensor, position: Float[np.ndarray, "k 3"], orientation: Float[np.ndarray, "k 4"]
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 4"]]:
    """Poses of the sensor frame (k, …) that go with these of the clamp."""
    still = np.zeros((len(position), 3))
    reactions = Reactions(
        Trail(position, orientation), still, still, time=np.arange(len(position), dtype=float)
    )
    raw = sensor.updated(position_noise=0.0).measure(reactions, np.random.default_rng(0))
    return raw.position, raw.orientation


def _refined(trail: Trail) -> Trail:
    """The same motion in more steps, so that reactions may be taken for linear between them."""
    factor = max(1, (_MOST_POSITIONS - 1) // (trail.count - 1))
    if factor == 1:
        return trail
    places = np.arange(trail.count, dtype=float)
    wanted = np.linspace(0, trail.count - 1, factor * (trail.count - 1) + 1)
    lanes = [
        Trail(*between(places, position, orientation, wanted))
        for position, orientation in zip(
            trail.position.reshape(-1, trail.count, 3),
            trail.orientation.reshape(-1, trail.count, 4),
            strict=True,
        )
    ]
    return lanes[0] if trail.position.ndim == 2 else Trail.stack(lanes)


def measured(
    scene: Scene,
    sensor: Sensor,
    rate: float,
    rng: np.random.Generator,
    *,
    tare: Float[np.ndarray, "6"],
    block: int = 512,
    repeat: bool = False,
) -> Iterator[RawRecording]:
    """What the sensor logs of a scene, block by block, without end: sample i at i/rate; `repeat`
    plays the scene again and again.
    """
    first = 0
    while True:
        time = np.arange(first, first + block) / rate
        within = np.mod(time, scene.duration) if repeat else time
        for start, stop in _increasing_runs(within):
            part = scene.reactions(within[start:stop])
            raw = sensor.measure(part, rng, force_tare=tare[:3], torque_tare=tare[3:])
            yield RawRecording(
                time[start:stop], raw.position, raw.orientation, raw.force, raw.torque
            )
        first += block


def _increasing_runs(time: Float[np.ndarray, "n"]) -> Iterator[tuple[int, int]]:
    """First and last + 1 of the stretches in which time increases."""
    breaks = [0, *(np.flatnonzero(np.diff(time) <= 0) + 1).tolist(), len(time)]
    yield from pairwise(breaks)
