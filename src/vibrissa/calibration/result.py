"""What a calibration returns."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import norm

from vibrissa.brief import brief
from vibrissa.calibration.arrays import Square
from vibrissa.calibration.bench import Bench, SetupLike, SetupType, bench_of
from vibrissa.calibration.held_out import HeldOut
from vibrissa.calibration.parameters import Parameter
from vibrissa.calibration.statistics import Fitness, Identifiability
from vibrissa.geometry.checks import share
from vibrissa.surfaces import Surface
from vibrissa.tolerances import Tolerances


@dataclass(frozen=True)
class Estimate:
    """One calibrated number.

    Attributes
    ----------
    name, unit
        What it is.
    given, value
        Before and after. For `clamp_orientation`, the components of the rotation vector from the
        given to the calibrated orientation, in the clamp's axes; for `object_position` and
        `object_orientation`, the shift and the rotation from where the object was given, in world
        axes, the rotation about `Calibration.pivot`.
    deviation
        Standard deviation; NaN where the parameter was held.
    determined
        Whether the data determine it; otherwise it was held as given.
    holds_for
        Held parameters from which it cannot be told apart: its value and interval are right if
        theirs are.
    """

    name: str
    unit: str
    given: float
    value: float
    deviation: float
    determined: bool
    holds_for: tuple[str, ...] = ()

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval; NaN where the parameter was held.

        Raises
        ------
        ValueError
            If the level is not between 0 and 1.
        """
        share(level, "level")
        half = float(norm.isf((1 - level) / 2)) * self.deviation
        return self.value - half, self.value + half


def concluded(
    setup: SetupLike,
    chosen: list[Parameter],
    free: list[Parameter],
    held: Mapping[str, tuple[str, ...]],
    bench: Bench,
    covariance: Square,
    alone: Float[np.ndarray, "k"],
    slopes: Float[np.ndarray, "k"],
) -> tuple[dict[str, Estimate], Square, Identifiability]:
    """Estimates of all that was to be free, by name; the covariance of what was determined; and
    what the data cannot tell apart.

    Parameters
    ----------
    bench
        As found.
    covariance, alone, slopes
        Covariance of the steps of what was determined; the deviation of each if all others were
        known; and factors from steps to changes of the values.
    """
    start, deviations = bench_of(setup.rod, setup.sensor), np.sqrt(np.diag(covariance))
    given, found = (one.numbers(setup.sensor) for one in (start, bench))
    names, scales = tuple(one.name for one in free), np.array([one.scale for one in free])
    known = dict(zip(names, abs(slopes) * deviations, strict=True))
    apart = {one: tuple(other for other in held[one] if other not in held) for one in held}
    estimates = {
        one.name: Estimate(
            one.name,
            one.unit,
            one.value(given),
            one.value(found),
            float(known.get(one.name, math.nan)),
            one.name in known,
            tuple(name for name, others in apart.items() if one.name in others),
        )
        for one in chosen
    }
    signs = np.sign(slopes)
    values, vectors = np.linalg.eigh(covariance / np.outer(scales, scales))
    identified = Identifiability(
        names=names,
        correlation=covariance / np.outer(deviations, deviations) * np.outer(signs, signs),
        directions=vectors.T[::-1],
        deviations=np.sqrt(np.maximum(values[::-1], 0.0)),
        alone=alone,
        held=apart,
    )
    return estimates, covariance * np.outer(slopes, slopes), identified


@dataclass(frozen=True, eq=False)
class Residuals:
    """The fitted rows: samples, or means of neighbouring samples.

    Attributes
    ----------
    recording, time
        (n,) index of the recording, and time [s].
    contact
        (n,) whether the rod touches; otherwise it is at rest.
    reading, predicted
        (n, 6) force [N] and torque [N m] on the rod, in the sensor's axes, about its wrench point,
        less the tare of the reactions that were given.
    whitened
        (n, 6) their difference, whitened by each row's covariance: white noise of variance 1 where
        the model is right.
    weight
        (n,) 1, less for rows that do not fit, 0 for rows without equilibrium.
    chi_square
        (n,) squared length of the whitened difference.
    """

    recording: Int[np.ndarray, "n"]
    time: Float[np.ndarray, "n"]
    contact: Bool[np.ndarray, "n"]
    reading: Float[np.ndarray, "n 6"]
    predicted: Float[np.ndarray, "n 6"]
    whitened: Float[np.ndarray, "n 6"]
    weight: Float[np.ndarray, "n"]
    chi_square: Float[np.ndarray, "n"]

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Calibration(Generic[SetupType]):
    """Setup calibrated from sweeps over a known object.

    Attributes
    ----------
    setup
        With the calibrated rod, sensor and, if its pose was free, surface.
    surface
        The object at the pose found; None if no object was known.
    estimates
        One for each free number, by name.
    covariance
        (k, k) of the numbers that were determined, in the order of `identifiability.names` and the
        units of the estimates.
    identifiability
        What these data cannot tell apart.
    residuals
        What the model leaves unexplained.
    fitness
        Whether noise explains that.
    tare, tare_deviation
        (recordings, 6) remaining tare at the middle of each recording, as force [N] and torque
        [N m] on the rod in the sensor's axes.
    drift, drift_deviation
        (recordings, 6) change from start to end.
    pivot
        (3,) point about which the object was turned.
    pose
        Rotation matrix (3, 3) and translation (3,) that take the object from where it was given to
        where it was found.
    friction
        Coulomb's coefficient, as given.
    unevenness
        Standard deviation of the gap at which the rod touches the object as given, along the normal
        and varying along the sweep, as shown by the data; 0 for none. Estimates and intervals allow
        for it.
    free
        Names that were free.
    warnings
        What speaks against setup, object or result, one sentence each; empty if all is well.
    held_out
        Each recording, or alternate stretches of a single one, predicted from the rest; without an
        object, each of several recordings.
    first_contact
        (recordings,) distance [m, or the rod's unit] by which the straight rod as calibrated
        contradicts where the loads begin; 0 where it agrees, NaN without an object.
    tolerances
        Those that entered the covariance, or None.
    """

    setup: SetupType
    surface: Surface | None
    estimates: dict[str, Estimate]
    covariance: Float[np.ndarray, "k k"]
    identifiability: Identifiability
    residuals: Residuals
    fitness: Fitness
    tare: Float[np.ndarray, "recordings 6"]
    tare_deviation: Float[np.ndarray, "recordings 6"]
    drift: Float[np.ndarray, "recordings 6"]
    drift_deviation: Float[np.ndarray, "recordings 6"]
    pivot: Float[np.ndarray, "3"]
    pose: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]
    friction: float
    unevenness: float
    free: tuple[str, ...]
    warnings: list[str]
    held_out: tuple[HeldOut, ...]
    first_contact: Float[np.ndarray, "recordings"]
    tolerances: Tolerances | None

    def __repr__(self) -> str:
        """Return five lines: data, estimates, what stays open, fit, and warnings."""
        found = [one for one in self.estimates.values() if one.determined]
        known = ", ".join(f"{one.name} {one.value:.5g} ± {one.deviation:.2g}" for one in found)
        still = ", ".join(name for name, one in self.estimates.items() if not one.determined)
        return (
            f"Calibration of {len(self.estimates)} parameters from {len(self.tare)} "
            f"recording{'s' * (len(self.tare) > 1)}, {len(self.residuals.time)} rows\n"
            f"  found: {known or 'nothing'}\n"
            f"  not determined: {still or 'none'}\n"
            f"  residuals: {self.fitness.reduced_chi_square**0.5:.3g} times the noise\n"
            f"  warnings: {len(self.warnings)}"
        )

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of an estimate.

        Raises
        ------
        ValueError
            If there is no estimate of that name, or the level is not between 0 and 1.
        """
        if name not in self.estimates:
            raise ValueError(f"name = {name!r}; allowed are {', '.join(self.estimates)}")
        return self.estimates[name].interval(level)
