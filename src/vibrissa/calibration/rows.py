"""From recordings to the rows that a calibration is fitted to.

Rows in contact hold the rod's mechanics, rows at rest the tare. What lies between, at first contact
and after detachment, is left out: there the rod swings.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import uniform_filter1d

from vibrissa.geometry.rotation import inverse, multiplied, rotation_matrices, unit_quaternions
from vibrissa.reactions import Reactions
from vibrissa.sensor import RawRecording, Sensor
from vibrissa.trail import Trail

# Samples over which the force is averaged before it is judged, in deviations of one sample: at rest
# |mean| is 0.58, and above 1.7 once in 10⁵.
_WINDOW = 9
_LOADED = 8.0
_ALARM = 1.7
_STIRRED = 0.01
# Share of the samples of a tare that is given from which it was taken in contact.
_MOST_LOADED = 0.25
_MARGIN = 0.03
_MOST_ROWS = 3000
_REST_ROWS = 50
_FEWEST = 30


class CalibrationError(ValueError):
    """Recordings that cannot be calibrated from: the text says why, and what is needed."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of all recordings, seen from the sensor, in units of the rod.

    Attributes
    ----------
    recording
        (n,) index of the recording.
    time
        (n,) from −½ at its start to ½ at its end.
    seconds
        (n,) [s], or the number of the sample.
    wrench
        (n, 6) support force and moment on the rod as read, tare roughly removed, sensor axes, about
        `Sensor.wrench_point`.
    covariance
        (n, 6, 6) of the wrench.
    position_covariance
        (n, 3, 3) of the sensor's position, world axes.
    pose
        (n, 15) position of the sensor in the world, its axes row by row, and `Sensor.wrench_point`.
    contact
        (n,) whether the rod touches; it is at rest otherwise.
    count
        (n,) how many samples were averaged.
    """

    recording: Int[np.ndarray, "n"]
    time: Float[np.ndarray, "n"]
    seconds: Float[np.ndarray, "n"]
    wrench: Float[np.ndarray, "n 6"]
    covariance: Float[np.ndarray, "n 6 6"]
    position_covariance: Float[np.ndarray, "n 3 3"]
    pose: Float[np.ndarray, "n 15"]
    contact: Bool[np.ndarray, "n"]
    count: Int[np.ndarray, "n"]

    @property
    def recordings(self) -> int:
        """How many recordings there are."""
        return int(self.recording[-1]) + 1


class _Samples(NamedTuple):
    """One recording, seen from the sensor."""

    seconds: Float[np.ndarray, "n"]
    wrench: Float[np.ndarray, "n 6"]
    covariance: Float[np.ndarray, "n 6 6"] | None
    position: Float[np.ndarray, "n 3"]
    orientation: Float[np.ndarray, "n 4"]
    position_covariance: Float[np.ndarray, "3 3"]


def gathered(recordings: list[Reactions | RawRecording], sensor: Sensor) -> Rows:
    """Rows of all recordings.

    Raises
    ------
    CalibrationError
        If a recording has no contact, no rest, or too few samples of either; if the noise is
        neither known nor to be seen.
    ValueError
        If a recording is of another kind than reactions or raw.
    """
    parts = [
        _rows(index, samples, sensor)
        for index, samples in enumerate(
            sample for recording in recordings for sample in _samples(recording, sensor)
        )
    ]
    if not parts:
        raise ValueError("recordings = []; allowed is at least one recording")
    return Rows(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in Rows.__dataclass_fields__
        )
    )


def _samples(recording: Reactions | RawRecording, sensor: Sensor) -> list[_Samples]:
    if isinstance(recording, RawRecording):
        recording = sensor.reactions(recording)
    if not isinstance(recording, Reactions):
        raise ValueError(
            f"recordings holds {type(recording).__name__}; allowed are Reactions (`read_recording`) and RawRecording (`Sensor.measure`)"
        )
    if recording.force.ndim == 2:
        return [_seen_from_the_sensor(recording, sensor)]
    return [
        _seen_from_the_sensor(_one(recording, index), sensor)
        for index in range(len(recording.force))
    ]


def _one(reactions: Reactions, index: int) -> Reactions:
    covariance = (
        reactions.covariance
        if reactions.covariance is None or reactions.covariance.ndim == 2
        else reactions.covariance[index]
    )
    time = None if reactions.time is None else reactions.time[index]
    trail = Trail(reactions.trail.position[index], reactions.trail.orientation[index])
    return Reactions(
        trail,
        reactions.force[index],
        reactions.moment[index],
        time,
        covariance,
        reactions.position_covariance,
    )


def _seen_from_the_sensor(reactions: Reactions, sensor: Sensor) -> _Samples:
    """Undo the mount that the reactions were made with."""
    orientation = multiplied(reactions.trail.orientation, inverse(sensor.clamp_orientation))
    axes = rotation_matrices(orientation)
    position = reactions.trail.position - axes @ sensor.clamp_position
    arm = sensor.clamp_position - np.asarray(sensor.wrench_point)
    lever = np.array([[0.0, -arm[2], arm[1]], [arm[2], 0.0, -arm[0]], [-arm[1], arm[0], 0.0]])
    carry = np.zeros((len(axes), 6, 6))
    carry[:, :3, :3] = carry[:, 3:, 3:] = np.swapaxes(axes, 1, 2)
    carry[:, 3:, :3] = lever @ carry[:, :3, :3]
    wrench = np.einsum(
        "nij,nj->ni", carry, np.concatenate([reactions.force, reactions.moment], axis=1)
    )
    covariance = (
        None
        if reactions.covariance is None
        else carry @ reactions.covariance @ np.swapaxes(carry, 1, 2)
    )
    seconds = np.arange(len(axes), dtype=np.float64) if reactions.time is None else reactions.time
    uncertain = (
        np.zeros((3, 3)) if reactions.position_covariance is None else reactions.position_covariance
    )
    return _Samples(seconds, wrench, covariance, position, orientation, uncertain)


def _rows(index: int, samples: _Samples, sensor: Sensor) -> Rows:
    where = f"recordings[{index}]"
    finite = np.isfinite(samples.wrench).all(axis=1)
    if np.count_nonzero(finite) < _FEWEST:
        raise CalibrationError(
            f"{where}: {np.count_nonzero(finite)} samples hold numbers; needed are at least {_FEWEST}"
        )
    noise = _noise(where, samples, sensor, finite)
    force = np.where(finite[:, None], samples.wrench[:, :3], 0.0)
    deviation = np.sqrt(np.trace(noise[:, :3, :3], axis1=1, axis2=2) / 3)
    strength = np.linalg.norm(uniform_filter1d(force, _WINDOW, axis=0), axis=1) / deviation
    contact, rest = _stretches(samples.seconds, strength, sensor.tare_seconds or 0.0)
    named = finite & (samples.seconds - samples.seconds[0] < (sensor.tare_seconds or 0.0))
    if np.any(named) and np.mean(strength[named] > _LOADED) > _MOST_LOADED:
        raise CalibrationError(
            f"{where}: the force changes within tare_seconds = {sensor.tare_seconds} by more than {_LOADED:g} times its noise; needed is a start free of contact"
        )
    contact, rest = contact & finite, rest & finite
    if np.count_nonzero(contact) < _FEWEST:
        raise CalibrationError(
            f"{where}: {np.count_nonzero(contact)} samples are in contact with more than {_LOADED:g} times the force's noise; needed are at least "
            f"{_FEWEST}: does the rod touch, and is the wrench's sign right?"
        )
    if np.count_nonzero(rest) < 2:
        raise CalibrationError(
            f"{where}: no sample is at rest and free of contact; needed is a start free of contact, which `tare_seconds` may name"
        )
    return _averaged(
        index,
        samples,
        noise,
        np.asarray(sensor.wrench_point),
        (_groups(contact, _MOST_ROWS), _groups(rest, _REST_ROWS)),
    )


def _noise(
    where: str, samples: _Samples, sensor: Sensor, finite: Bool[np.ndarray, "n"]
) -> Float[np.ndarray, "n 6 6"]:
    """Stated covariances of the samples; where none is, what the scatter within the tare window
    says.
    """
    if samples.covariance is not None:
        return np.broadcast_to(samples.covariance, (len(finite), 6, 6))
    still = finite & (samples.seconds - samples.seconds[0] < (sensor.tare_seconds or 0.0))
    if np.count_nonzero(still) < _FEWEST:
        raise CalibrationError(
            f"{where}: the sensor's noise is not known; give force_noise and torque_noise, or a tare_seconds with at least {_FEWEST} samples to see it from"
        )
    variance = np.var(samples.wrench[still], axis=0, ddof=1)
    if not np.all(variance > 0):
        raise CalibrationError(
            f"{where}: a channel does not scatter at rest, so that its noise cannot be seen; give force_noise and torque_noise"
        )
    return np.broadcast_to(np.diag(variance), (len(finite), 6, 6))


def _stretches(
    seconds: Float[np.ndarray, "n"], strength: Float[np.ndarray, "n"], tare_seconds: float
) -> tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """Samples in contact, and samples at rest: the start free of contact, and the end if it is."""
    contact = strength > _LOADED
    rest = seconds - seconds[0] < tare_seconds
    margin = max(_MARGIN * (seconds[-1] - seconds[0]), _WINDOW * float(np.median(np.diff(seconds))))
    if tare_seconds == 0:
        alarm = np.flatnonzero(strength > _ALARM)
        rest = seconds < (seconds[alarm[0]] - margin if alarm.size else np.inf)
    last = np.flatnonzero(contact)
    if last.size:
        after = seconds > seconds[last[-1]] + margin
        if np.count_nonzero(after) >= _FEWEST and np.mean(strength[after] > _ALARM) < _STIRRED:
            rest = rest | after
    return contact & ~rest, rest


def _groups(
    chosen: Bool[np.ndarray, "n"], most: int
) -> tuple[Int[np.ndarray, "k"], Int[np.ndarray, "groups"]]:
    """Indices of chosen samples, and where among them each group begins: neighbours, as many as
    keeps the groups to about `most`.
    """
    index = np.flatnonzero(chosen)
    size = max(1, -(-len(index) // most))
    run = np.cumsum(np.diff(index, prepend=index[0] - 1) > 1)
    within = np.arange(len(index)) - np.searchsorted(run, run)
    return index, np.flatnonzero(within % size == 0)


def _averaged(
    recording: int,
    samples: _Samples,
    noise: Float[np.ndarray, "n 6 6"],
    wrench_point: Float[np.ndarray, "3"],
    groups: tuple[
        tuple[Int[np.ndarray, "k"], Int[np.ndarray, "_"]],
        tuple[Int[np.ndarray, "l"], Int[np.ndarray, "_"]],
    ],
) -> Rows:
    contact, rest = groups
    index = np.concatenate([contact[0], rest[0]])
    starts = np.concatenate([contact[1], rest[1] + len(contact[0])])
    count = np.diff(starts, append=len(index))

    def mean(values: Float[np.ndarray, "n *rest"]) -> Float[np.ndarray, "groups *rest"]:
        total = np.add.reduceat(values[index], starts, axis=0)
        return total / count.reshape(-1, *[1] * (total.ndim - 1))

    first = np.repeat(samples.orientation[index[starts]], count, axis=0)
    aligned = samples.orientation.copy()
    aligned[index] *= np.sign(np.sum(aligned[index] * first, axis=1, keepdims=True)) + 0.0
    axes = rotation_matrices(unit_quaternions(mean(aligned), "orientation"))
    seconds = mean(samples.seconds)
    number = len(starts)
    shared = count[:, None, None]
    return Rows(
        recording=np.full(number, recording),
        time=(seconds - samples.seconds[0]) / np.ptp(samples.seconds) - 0.5,
        seconds=seconds,
        wrench=mean(samples.wrench),
        covariance=mean(noise) / shared,
        position_covariance=np.broadcast_to(samples.position_covariance, (number, 3, 3)) / shared,
        pose=np.concatenate(
            [
                mean(samples.position),
                axes.reshape(-1, 9),
                np.broadcast_to(wrench_point, (number, 3)),
            ],
            axis=1,
        ),
        contact=np.arange(number) < len(contact[1]),
        count=count,
    )
