"""From recordings to the rows that a calibration is fitted to.

Rows in contact show the rod's mechanics, rows at rest the tare. What lies between, at first contact
and after detachment, is left out, as the rod swings there.
"""

from collections.abc import Iterable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int, Shaped
from scipy.ndimage import uniform_filter1d

from vibrissa.calibration.arrays import Chosen, Numbers, Vectors, Wrenches
from vibrissa.calibration.equilibrium import Pose
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.mechanics.free import free_reactions
from vibrissa.reactions import Reactions
from vibrissa.sensor import RawRecording, Sensor
from vibrissa.trail import Trail

_WINDOW = 9
"""Samples over which the force is averaged before it is judged. In deviations of one sample, |mean|
is 0.58 at rest, and above 1.7 once in 10⁵."""
_LOADED = 8.0
"""Deviations from which it is a contact: five times those at rest, and 2 % of a usual force."""
_OWN = 4.0
"""Deviations of the sample's own force in contact: next to a jump only the average shows a load. At
rest one sample in a thousand exceeds them; in such a contact one in 10⁵ falls short of them."""
_ALARM, _STIRRED = 1.7, 0.01
"""Deviations not seen at rest, and the share of a stretch's samples that may show them."""
_MOST_LOADED = 0.25
"""Share of a stated tare's samples in contact above which it was not taken at rest."""
_MARGIN = 0.03
"""Share of a recording before and after the contact that is not counted as rest: the rod swings."""
_MOST_ROWS, _REST_ROWS = 3000, 50
"""Rows per recording: more are averaged, as neighbours say the same."""
_FEWEST = 30
"""Samples that give a variance to within a quarter."""


class CalibrationError(ValueError):
    """Recordings that cannot be used to calibrate: the text says why, and what is needed."""


class PoseNoise(NamedTuple):
    """Errors of the robot's pose, world axes."""

    position: Float[np.ndarray, "*n 3 3"]
    """Covariance of the sensor's position."""
    rotation: Float[np.ndarray, "*n 3 3"]
    """Covariance of a rotation vector, by which sensor and rod turn as one body."""
    center: Float[np.ndarray, "*n 3"]
    """Point about which they turn."""


class Rows(NamedTuple):
    """Rows of all recordings (n,), seen from the sensor, in units of the rod."""

    recording: Int[np.ndarray, "n"]
    time: Numbers
    """From −½ at the start of the recording to ½ at its end."""
    seconds: Numbers
    """Time [s], or the number of the sample."""
    wrench: Wrenches
    """Support force and moment on the rod as read, tare roughly removed, sensor axes, about
    `Sensor.wrench_point`."""
    covariance: Float[np.ndarray, "n 6 6"]
    pose: Pose
    noise: PoseNoise
    contact: Chosen
    """Whether the rod touches; it is at rest otherwise."""
    samples: Int[np.ndarray, "n"]
    """How many samples were averaged."""

    @property
    def recordings(self) -> int:
        """How many recordings there are."""
        return int(self.recording[-1]) + 1

    @property
    def contacts(self) -> list[Int[np.ndarray, "rows"]]:
        """Rows in contact of each recording."""
        return [
            np.flatnonzero(self.contact & (self.recording == one)) for one in range(self.recordings)
        ]


def gathered(sweeps: list[Reactions], sensor: Sensor) -> Rows:
    """Rows of all sweeps.

    Raises
    ------
    CalibrationError
        If a sweep has no contact, no rest, or too few samples of either; if the noise is neither
        known nor visible in the data.
    """
    return _joined(_rows(index, one, sensor) for index, one in enumerate(sweeps))


def _joined(parts: Iterable[Rows]) -> Rows:
    return jax.tree.map(lambda *part: np.concatenate(part), *parts)


def sweeps_of(recordings: list[Reactions | RawRecording], sensor: Sensor) -> list[Reactions]:
    """Reactions on each trail; for raw recordings, as the sensor computes them.

    Raises
    ------
    ValueError
        If a recording is of neither type, or there is none.
    """
    found: list[Reactions] = []
    for recording in recordings:
        one = sensor.reactions(recording) if isinstance(recording, RawRecording) else recording
        if not isinstance(one, Reactions):
            raise ValueError(
                f"recordings holds {type(recording).__name__}; allowed are Reactions "
                "(`read_recording`) and RawRecording (`Sensor.measure`)"
            )
        found += [one] if one.force.ndim == 2 else [one[trail] for trail in range(len(one.force))]
    if not found:
        raise ValueError("recordings = []; allowed is at least one recording")
    return found


def _samples(index: int, given: Reactions, sensor: Sensor) -> Rows:
    """A row for each sample, undoing the mount that the reactions were computed with; without noise
    where it is not known.
    """
    pose, count = sensor.frame(given.trail), given.trail.count
    plain = Sensor(
        sensor.clamp_position, sensor.clamp_orientation, "on_rod", wrench_point=sensor.wrench_point
    )
    maps = plain.to_readings(pose.orientation)
    wrench = given.wrench

    def known(values: np.ndarray | None, default: np.ndarray) -> np.ndarray:
        return default if values is None else np.broadcast_to(values, default.shape)

    seconds, none = known(given.time, np.arange(float(count))), np.zeros((count, 3, 3))
    return Rows(
        recording=np.full(count, index),
        time=(seconds - seconds[0]) / np.ptp(seconds) - 0.5,
        seconds=seconds,
        wrench=np.einsum("nij,nj->ni", maps, wrench),
        covariance=maps @ known(given.covariance, np.zeros((count, 6, 6))) @ maps.swapaxes(1, 2),
        pose=Pose(pose.position, rotation_matrices(pose.orientation)),
        noise=PoseNoise(
            known(given.position_covariance, none),
            known(given.rotation_covariance, none),
            known(given.rotation_center, pose.position),
        ),
        contact=np.zeros(count, dtype=bool),
        samples=np.ones(count, dtype=int),
    )


def _own_force(clamp: Trail, sensor: Sensor) -> Vectors:
    """Force of the loads along the rod without contact, sensor axes."""
    if sensor.rod is None:
        return np.zeros((clamp.count, 3))
    axes = rotation_matrices(sensor.frame(clamp).orientation)
    own: Vectors = np.einsum("nji,nj->ni", axes, free_reactions(sensor.rod, clamp)[:, :3])
    return own


def _rows(index: int, given: Reactions, sensor: Sensor) -> Rows:
    def needs(enough: object, text: str) -> None:
        if not enough:
            raise CalibrationError(f"recordings[{index}]: {text}")

    finite = np.isfinite(given.force).all(axis=1) & np.isfinite(given.moment).all(axis=1)
    needs(
        np.count_nonzero(finite) >= _FEWEST,
        f"{np.count_nonzero(finite)} samples hold numbers; at least {_FEWEST} are needed",
    )
    samples = _samples(index, given, sensor)
    seconds, noise = samples.seconds - samples.seconds[0], samples.covariance
    tare_seconds = sensor.tare_seconds or 0.0
    tared = finite & (seconds < tare_seconds)
    if given.covariance is None:
        needs(
            np.count_nonzero(tared) >= _FEWEST,
            "the sensor's noise is not known; give force_noise and torque_noise, or a tare_seconds "
            f"with at least {_FEWEST} samples to see it from",
        )
        variance = np.var(samples.wrench[tared], axis=0, ddof=1)
        needs(
            np.all(variance > 0),
            "a channel does not scatter at rest, so that its noise cannot be seen; give "
            "force_noise and torque_noise",
        )
        noise = np.broadcast_to(np.diag(variance), noise.shape)
    force = np.where(finite[:, None], samples.wrench[:, :3] - _own_force(given.trail, sensor), 0.0)
    deviation = np.sqrt(np.trace(noise[:, :3, :3], axis1=1, axis2=2) / 3)

    def strength_of(force: Vectors) -> Numbers:
        size = np.linalg.norm(uniform_filter1d(force, _WINDOW, axis=0), axis=1)
        return np.asarray(size / deviation)

    strength, zero = strength_of(force), force[tared].mean(axis=0) if tared.any() else np.zeros(3)
    left = np.mean(strength[tared] > _LOADED) if tared.any() else 0.0
    needs(
        left <= _MOST_LOADED or np.mean(strength_of(force - zero)[tared] > _LOADED) > _MOST_LOADED,
        f"the force is {1e3 * np.linalg.norm(zero):.3g} mN throughout tare_seconds = "
        f"{sensor.tare_seconds}; allowed are reactions less the sensor's zero, and a start free of "
        "contact",
    )
    needs(
        left <= _MOST_LOADED,
        f"the force changes within tare_seconds = {sensor.tare_seconds} by more than {_LOADED:g} "
        "times its noise; a start free of contact is needed",
    )
    loaded = (strength > _LOADED) & (np.linalg.norm(force, axis=1) / deviation > _OWN)
    contact, rest = (part & finite for part in _stretches(seconds, strength, loaded, tare_seconds))
    needs(
        np.count_nonzero(contact) >= _FEWEST,
        f"{np.count_nonzero(contact)} samples are in contact with more than {_LOADED:g} times the "
        f"force's noise; at least {_FEWEST} are needed: does the rod touch, and is the wrench's "
        "sign right?",
    )
    needs(
        np.count_nonzero(rest) >= 2,
        "no sample is at rest and free of contact; a start free of contact is needed, which "
        "`tare_seconds` may name",
    )
    samples = samples._replace(covariance=noise, contact=contact)
    return _joined([_averaged(samples, contact, _MOST_ROWS), _averaged(samples, rest, _REST_ROWS)])


def _stretches(
    seconds: Numbers, strength: Numbers, contact: Chosen, tare_seconds: float
) -> tuple[Chosen, Chosen]:
    """Samples in contact, and samples at rest: the start free of contact, and the end if so too."""
    rest = seconds < tare_seconds
    margin = max(_MARGIN * seconds[-1], _WINDOW * float(np.median(np.diff(seconds))))
    if tare_seconds == 0:
        alarm = np.flatnonzero(strength > _ALARM)
        rest = seconds < (seconds[alarm[0]] - margin if alarm.size else np.inf)
    last = np.flatnonzero(contact)
    if last.size:
        after = seconds > seconds[last[-1]] + margin
        if np.count_nonzero(after) >= _FEWEST and np.mean(strength[after] > _ALARM) < _STIRRED:
            rest = rest | after
    return contact & ~rest, rest


def _averaged(samples: Rows, chosen: Chosen, most: int) -> Rows:
    """Means of neighbouring chosen samples, over as many as it takes to get about `most` rows."""
    index = np.flatnonzero(chosen)
    size = -(-len(index) // most)
    run = np.cumsum(np.diff(index, prepend=index[0] - 1) > 1)
    starts = np.flatnonzero((np.arange(len(index)) - np.searchsorted(run, run)) % size == 0)
    count = np.diff(starts, append=len(index))

    def mean(values: Shaped[np.ndarray, "n *rest"]) -> Float[np.ndarray, "rows *rest"]:
        total = np.add.reduceat(values[index], starts, axis=0, dtype=float)
        return total / count.reshape(-1, *[1] * (total.ndim - 1))

    means: Rows = jax.tree.map(mean, samples)
    left, _, right = np.linalg.svd(means.pose.axes)
    noise, shared = means.noise, count[:, None, None]
    return means._replace(
        recording=samples.recording[index[starts]],
        covariance=means.covariance / shared,
        pose=means.pose._replace(axes=left @ right),
        noise=noise._replace(position=noise.position / shared, rotation=noise.rotation / shared),
        contact=samples.contact[index[starts]],
        samples=count,
    )
