"""A rod on a sensor on an arm, simulated: poses in, smoothed contacts out."""

from dataclasses import dataclass, field

import numpy as np

from vibrissa.forward import scan
from vibrissa.geometry.checks import positive
from vibrissa.inverse import Reconstruction, reconstruct, smooth
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor import Sensor
from vibrissa.surfaces import Surface
from vibrissa.trail import Trail, between


@dataclass(frozen=True)
class SimulatedArm:
    """Drives trails along a known object and returns what a sensor would make of them: scan,
    measurement with noise and tare, reconstruction, smoothing. It stands in for a robot in `follow`
    and in studies of strategies.

    Attributes
    ----------
    rod, surface, sensor
        What is swept along what, and measured how; in SI units.
    speed
        Of the clamp point, plus a rod's length per radian of its turning [m/s].
    rate
        Samples per second [1/s].
    friction
        Coulomb friction coefficient.
    rng
        Source of the noise.

    Raises
    ------
    ValueError
        If speed or rate is not positive.
    """

    rod: Rod
    surface: Surface
    sensor: Sensor
    speed: float = 0.02
    rate: float = 100.0
    friction: float = 0.0
    rng: np.random.Generator = field(default_factory=np.random.default_rng)

    def __post_init__(self) -> None:
        """Check the numbers."""
        positive(self.speed, "speed")
        positive(self.rate, "rate")

    def __call__(self, trail: Trail) -> Reconstruction:
        """Smoothed contacts (n) along a trail, driven after a rest long enough for the tare.
        Samples whose equilibrium was not found are missing.

        Raises
        ------
        ValueError
            If the clamp is inside the object at every position.
        """
        rest = self.sensor.tare_seconds + _LONGER if self.sensor.tare_seconds else 0.0
        shift, turn = np.split(trail.steps, 2, axis=1)
        far = np.linalg.norm(shift, axis=1) + self.rod.length * np.linalg.norm(turn, axis=1)
        reached = np.concatenate([[0.0], np.cumsum(far)]) / self.speed
        time = np.arange(int((rest + reached[-1]) * self.rate) + 1) / self.rate
        driven = between(rest + reached, trail, time)
        moving = time >= rest
        found = scan(self.rod, self.surface, driven[moving], friction=self.friction)
        still = np.zeros((int((~moving).sum()), 3))
        force = np.concatenate([still, found.reactions.force])
        moment = np.concatenate([still, found.reactions.moment])
        logged = np.isfinite(force).all(axis=1) & np.isfinite(moment).all(axis=1)
        exact = Reactions(driven[logged], force[logged], moment[logged], time=time[logged])
        measured = self.sensor.reactions(self.sensor.measure(exact, self.rng))
        return smooth(reconstruct(self.rod, measured, friction=self.friction, check=False))


_LONGER = 0.05
"""Seconds of rest beyond those of the tare."""
