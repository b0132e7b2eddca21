"""Which layout and which sign of the wrench fit a recording, if names leave them open.

The clamp's work equals the rod's bending energy (`vibrissa.inverse.work`) only as the file is
meant: a wrong sign makes the work negative, a wrong unit a thousand times too large.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from vibrissa.files import InputError
from vibrissa.inverse.work import clamp_work
from vibrissa.io.recordings.propose import Layout
from vibrissa.io.recordings.read import read_raw
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.setup import Setup
from vibrissa.rod import Rod
from vibrissa.sensor import Inspection, Sensor, inspect_raw
from vibrissa.sensor.sensor import WrenchSign

# A rod and a clamp measured with a ruler are a few per cent off, and friction adds to the work: a
# wrong sign gives about -1, the nearest wrong unit 10.
_FITS = (0.6, 2.5)
_MOST_GAINED = 0.3
# Misfits within this of the best, as a factor and in parts of the energy, count as equally good.
_ALIKE = (2.0, 0.02)
# Radians: orientations closer than a robot's error are the same.
_SAME = 5e-3


@dataclass(frozen=True, eq=False)
class _Trial:
    """A recording read in one way."""

    keys: dict[str, Any]
    wrench: WrenchSign
    inspection: Inspection
    ratio: float
    misfit: float

    @property
    def choice(self) -> dict[str, Any]:
        """What was chosen, the sign included."""
        return {**self.keys, "wrench": self.wrench}


@dataclass(frozen=True, eq=False)
class Decision:
    """What a recording tells about its layout and the sign of its wrench.

    Attributes
    ----------
    keys
        Of [recording]: what was known or could be decided.
    undecided
        Values of the keys, or of "wrench", that fit equally well; empty if all was decided.
    wrench
        "on_sensor" or "on_rod", None if the recording does not tell.
    ratios
        The clamp's work over the rod's bending energy by sign, for the layout chosen; empty if no
        contact could be judged.
    inspection
        Of the recording in the way chosen, None if it cannot be read in any.
    reason
        Why it cannot, or why nothing could be judged.
    """

    keys: dict[str, Any]
    undecided: dict[str, tuple[Any, ...]]
    wrench: WrenchSign | None
    ratios: Mapping[str, float]
    inspection: Inspection | None
    reason: str = ""


def decided(
    path: str | Path, layout: Layout, rod: Rod, sensor: Sensor, wrench: WrenchSign | None = None
) -> Decision:
    """Decide what a layout leaves open, and the sign of the wrench.

    Parameters
    ----------
    path
        The recording.
    layout
        As proposed, with columns for all quantities.
    rod, sensor
        As measured; the sensor's own sign is not used.
    wrench
        The sign, if it is known.

    Raises
    ------
    InputError
        If the recording cannot be read in any of these ways.
    """
    signs = (wrench,) if wrench else get_args(WrenchSign)
    trials, reasons = list[_Trial](), list[str]()
    for keys in _distinct(Path(path), layout, Setup(rod, sensor)):
        for sign in signs:
            try:
                trials.append(_trial(Path(path), keys, rod, replace(sensor, wrench=sign)))
            except InputError as error:
                reasons.append(str(error))
    if not trials:
        raise InputError(reasons[0])
    return _judged(layout, trials, wrench, reasons)


def _judged(
    layout: Layout, trials: list[_Trial], wrench: WrenchSign | None, reasons: list[str]
) -> Decision:
    sound = [trial for trial in trials if not trial.inspection.unusable]
    fits = [trial for trial in sound if np.isfinite(trial.misfit)]
    best = min((trial.misfit for trial in fits), default=0.0)
    factor, more = _ALIKE
    good = [trial for trial in fits if trial.misfit <= factor * best + more] or sound or trials
    chosen = min(good, key=lambda trial: trial.misfit)
    values = {
        key: tuple(dict.fromkeys(trial.choice[key] for trial in good))
        for key in (*layout.undecided, "wrench")
    }
    undecided = {key: several for key, several in values.items() if len(several) > 1}
    told: dict[str, float] = {
        trial.wrench: trial.ratio
        for trial in trials
        if trial.keys == chosen.keys and np.isfinite(trial.ratio)
    }
    sign = None if "wrench" in undecided else chosen.wrench
    unusable = [fault.text for fault in chosen.inspection.unusable] or reasons
    if fits:
        reason = ""
    elif told:
        shown = " and ".join(f"{ratio:.2g} ({name})" for name, ratio in told.items())
        ratios = f"the clamp's work is {shown} times the rod's bending energy, not 1"
        reason = f"{ratios}: check rod and clamp"
    else:
        reason = unusable[0] if unusable else "no contact begins and ends with the rod free"
    keys = {key: value for key, value in chosen.keys.items() if key not in undecided}
    return Decision(keys, undecided, wrench or sign, told, chosen.inspection, reason)


def _distinct(file: Path, layout: Layout, setup: Setup) -> list[dict[str, Any]]:
    """The ways to read a file, without those that give the same orientations as an earlier one."""
    ways, turns = list[dict[str, Any]](), list[tuple[dict[str, Any], Any]]()
    angles = {"orientation_form", "angle_unit"}
    for keys in layout.all_keys():
        others = {key: value for key, value in keys.items() if key not in angles}
        try:
            table = RecordingTable.model_validate(keys)
            turn = read_raw(file, replace(setup, recording=table)).raw.orientation
        except (InputError, ValueError):
            ways.append(keys)
            continue
        same = [
            known
            for other, known in turns
            if other == others and np.nanmax(np.abs(known - turn), initial=0.0) < _SAME
        ]
        if not same:
            turns.append((others, turn))
            ways.append(keys)
    return ways


def _trial(file: Path, keys: dict[str, Any], rod: Rod, sensor: Sensor) -> _Trial:
    """Read a recording in one way, and compare work and energy of its contacts."""
    setup = Setup(rod, sensor, recording=RecordingTable.model_validate(keys))
    try:
        recording = read_raw(file, setup)
        poses = recording.poses
        own = (poses.time, poses.position, poses.orientation) if poses else None
        found = inspect_raw(recording.marked, sensor, rod, poses=own)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error
    ratio, misfit = np.nan, np.inf
    if found.tare is not None and not found.unusable:
        noisy = with_noise(found.sensor, found)
        works = clamp_work(rod, noisy.reactions(found.cleaned, found.tare))
        if works:
            ratio = max((work.ratio for work in works), key=lambda one: abs(one - 1.0))
            low, high = _FITS
            fits = all(low < work.ratio < high and work.gained < _MOST_GAINED for work in works)
            misfit = max(work.misfit for work in works) if fits else np.inf
    return _Trial(keys, sensor.wrench, found, ratio, misfit)


def with_noise(sensor: Sensor, found: Inspection) -> Sensor:
    """A sensor whose noise is not stated, with that found at rest."""
    known = np.isfinite(found.noise).all() and (found.noise > 0).all()
    if sensor.noise.known or not known:
        return sensor
    force, torque = (tuple(part.tolist()) for part in np.split(found.noise, 2))
    return sensor.updated(force_noise=force, torque_noise=torque)
