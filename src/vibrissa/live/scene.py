"""A scan played in time, as a sensor would feel it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from vibrissa.forward import scan
from vibrissa.geometry.checks import not_negative, positive
from vibrissa.live.poses import between, linear
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor import RawRecording, Sensor
from vibrissa.surfaces import Surface
from vibrissa.trail import Trail

_MOST_POSITIONS = 4001  # of a scan: steps of 10 µm over 40 mm, between which reactions are linear


@dataclass(frozen=True, eq=False)
class Scene:
    """Reactions at the clamp over time: at rest before the first trail, along it, then on to the
    next one.

    Attributes
    ----------
    time
        (k,) [s], increasing, from 0.
    trail
        Clamp poses (k, …).
    force, moment
        (k, 3) on the rod, world axes.
    """

    time: Float[np.ndarray, "k"]
    trail: Trail
    force: Float[np.ndarray, "k 3"]
    moment: Float[np.ndarray, "k 3"]

    @property
    def duration(self) -> float:
        """Seconds until the last trail has been swept."""
        return float(self.time[-1])

    def reactions(self, time: Float[np.ndarray, "n"]) -> Reactions:
        """Reactions (n, …) at these times [s], increasing; after the end, the clamp stands."""
        trail = between(self.time, self.trail, time)
        force, moment = (linear(self.time, part, time) for part in (self.force, self.moment))
        return Reactions(trail, force, moment, time=time)


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
    time, clamp = motion(fine, rest=rest, sweep=sweep, pause=pause)
    felt = scan(rod, surface, fine, friction=friction, finite_radius=finite_radius).reactions
    force, moment = (
        _after(rest, np.nan_to_num(part).reshape(-1, 3)) for part in (felt.force, felt.moment)
    )
    return Scene(time, clamp, force, moment)


def motion(
    trail: Trail, *, rest: float, sweep: float, pause: float
) -> tuple[Float[np.ndarray, "k"], Trail]:
    """Time (k,) [s] and clamp poses (k, …) of trails that are swept one after the other; arguments
    and errors as for `swept`.
    """
    not_negative(rest, "rest")
    positive(sweep, "sweep")
    positive(pause, "pause")
    if trail.count < 2:
        raise ValueError(f"trail has {trail.count} positions; allowed are at least 2")
    position, orientation = trail.position.reshape(-1, 3), trail.orientation.reshape(-1, 4)
    start = rest + (sweep + pause) * np.arange(len(position) // trail.count)
    time = np.add.outer(start, np.linspace(0.0, sweep, trail.count)).ravel()
    time = np.concatenate([[0.0], time]) if rest else time
    return time, Trail(_after(rest, position), _after(rest, orientation))


def _after(rest: float, rows: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "n c"]:
    """The first row also at the beginning of the rest, if there is one."""
    return np.concatenate([rows[:1], rows]) if rest else rows


def _refined(trail: Trail) -> Trail:
    """The same motion in more steps, so that reactions may be taken for linear between them."""
    steps = max(trail.count - 1, 1)
    wanted = np.linspace(0, steps, max((_MOST_POSITIONS - 1) // steps, 1) * steps + 1)
    several = trail if trail.position.ndim == 3 else Trail.stack([trail])
    given = np.arange(float(trail.count))
    lanes = range(len(several.position))
    return Trail.stack([between(given, several[lane], wanted) for lane in lanes])


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
    """What the sensor logs of a scene, in blocks of rows, without end: sample i at i/rate; `repeat`
    plays the scene again and again.
    """
    first, begin, end = 0, 0.0, scene.duration if repeat else math.inf
    while True:
        time = np.arange(first, first + block) / rate
        time = time[time < end]
        if len(time):
            part = scene.reactions(time - begin)
            raw = sensor.measure(part, rng, force_tare=tare[:3], torque_tare=tare[3:])
            yield replace(raw, time=time)
            first += len(time)
        else:
            begin, end = end, end + scene.duration
