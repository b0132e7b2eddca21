"""Files that are read without an error and misread all the same: units, order of the quaternions,
signs and axes.

The clamp's work and the rod's bending energy are two routes to one number
(`vibrissa.inverse.work`). Where they contradict each other, each known mistake is undone in turn;
those that bring them together, leave the contacts on the rod and the noise at rest as stated are
named.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.geometry.rotation import rotation_matrices, rotation_vectors
from vibrissa.inverse.work import ClampWork, clamp_work
from vibrissa.io.recordings import units
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.rod import Rod
from vibrissa.sensor import Fault, FaultKind, Inspection, RawRecording, Sensor
from vibrissa.sensor.raw import CHANNELS
from vibrissa.sensor.sensor import WrenchFrame, WrenchSign
from vibrissa.sensor.tare import fitted_tare
from vibrissa.sensor.units import plausible_load

# Without friction the right reading leaves a few thousandths.
_SOUND = 0.03
_DEVIATIONS = 6.0
# While it is loaded first: below is impossible, above takes friction.
_FRICTIONLESS = (0.95, 1.05)
_WITH_FRICTION = (0.95, 2.5)
# A reading that looks like friction is doubted where another one looks like none: on sound
# recordings under friction the ratio is 1.1 and more.
_DOUBTED = 1.1
_MOST_NAMED = 3
_TURNED = 5e-3
_NOISE = 3.0
_HALF_TURN = 0.99
_ROWS = 400
# Radians, and shares of the rod's length: less tells nothing of an axis.
_LEAST_TURN, _LEAST_WAY = 0.1, 0.02
# Of the way's extent, and of the residual as read: the pose's noise is far below both.
_SPOILT, _TRUE = 0.1, 0.05


class Reading(NamedTuple):
    """The same file, read otherwise."""

    words: str
    raw: RawRecording
    sensor: Sensor
    rod: Rod


def misread_faults(
    found: Inspection,
    rod: Rod,
    stated: Sensor,
    table: RecordingTable | None,
    degrees: Callable[[], RawRecording],
) -> list[Fault]:
    """A finding that names the likeliest mistakes, where the recording as read contradicts itself
    and with one of them undone it does not.

    Parameters
    ----------
    found
        Of the recording as read.
    rod, stated
        Rod and sensor as stated.
    table
        How the file was read; None where the setup says nothing.
    degrees
        Reads it again with its angles in degrees, row for row.
    """
    if found.unusable or found.tare is None or not found.usable.any():
        return []
    layout = table or RecordingTable()
    given = Reading("", found.cleaned, found.sensor, rod)
    turned = _turned_about(given, layout, degrees)
    if turned is not None:
        return [_fault(turned, found)]
    works = _works(given, found)
    if not works:
        return []
    worst = max(works, key=lambda work: abs(np.log(max(abs(work.ratio), 1e-9))) + work.gained)
    if (
        any(work.impossible for work in works)
        or worst.ratio > _DOUBTED + _DEVIATIONS * worst.ratio_deviation
    ):
        low, high = _WITH_FRICTION
        gross = not low / high < worst.ratio < high
        likely = _likely(
            given, found, stated, layout, degrees, _WITH_FRICTION if gross else _FRICTIONLESS
        )
        if not likely:
            return []
        text = f"{' or '.join(reading.words for reading in likely)}? The clamp's work is {worst.ratio:.3g} times the rod's bending energy as the file is read, "
        return [_fault(f"{text}and {_ratio(likely[0], found):.3g} times with that undone", found)]
    return _half_turned(given, found, layout)


def _fault(text: str, found: Inspection) -> Fault:
    return Fault(
        FaultKind.UNITS,
        CHANNELS,
        float(found.cleaned.time[0]),
        float(found.cleaned.time[-1]),
        len(found.usable),
        text,
    )


def _works(reading: Reading, found: Inspection) -> list[ClampWork]:
    """Work and energy of the contacts of a reading; none where it is no recording of contacts on
    this rod.
    """
    tare = found.tare
    assert tare is not None
    try:
        again = (
            fitted_tare(reading.sensor, reading.raw, tare.intervals, tare.found)
            if tare.intervals
            else tare
        )
    except ValueError:
        return []
    reactions = reading.sensor.reactions(reading.raw, again)
    return clamp_work(reading.rod, reactions)


def _ratio(reading: Reading, found: Inspection) -> float:
    return max(_works(reading, found), key=lambda work: float(work.energy.max())).ratio


def _likely(
    given: Reading,
    found: Inspection,
    stated: Sensor,
    table: RecordingTable,
    degrees: Callable[[], RawRecording],
    allowed: tuple[float, float],
) -> list[Reading]:
    """Other readings in which work and energy agree, the best first."""
    scored = []
    for reading in _readings(given, table, degrees):
        if not _stated_noise(reading, found, stated) or not plausible_load(
            reading.raw, reading.sensor, found.tare, reading.rod
        ):
            continue
        works = _works(reading, found)
        if works and all(_sound(work, allowed) for work in works):
            scored.append((max(work.misfit for work in works), reading))
    scored.sort(key=lambda pair: pair[0])
    best = scored[0][0] if scored else 0.0
    return [reading for misfit, reading in scored if misfit < 2 * best + _SOUND / 2][:_MOST_NAMED]


def _sound(work: ClampWork, allowed: tuple[float, float]) -> bool:
    low, high = allowed
    slack = _DEVIATIONS * work.ratio_deviation
    return (
        work.gained < _SOUND + _DEVIATIONS * work.deviation
        and low - slack < work.ratio < high + slack
    )


def _stated_noise(reading: Reading, found: Inspection, stated: Sensor) -> bool:
    """Whether the noise at rest is as stated, to a factor of three; a channel without any is of a
    simulation, in any unit.
    """
    tare = found.tare
    assert tare is not None
    if stated.force_noise is None or not tare.intervals:
        return True
    start, stop = tare.intervals[0]
    rows = (
        (reading.raw.time >= start)
        & (reading.raw.time < stop)
        & np.isfinite(reading.raw.wrench).all(axis=1)
    )
    ratio = np.std(reading.raw.wrench[rows], axis=0) / np.sqrt(stated.reading_variance)
    return bool(np.all((ratio == 0) | (ratio > 1 / _NOISE) & (ratio < _NOISE)))


def _readings(
    given: Reading, table: RecordingTable, degrees: Callable[[], RawRecording]
) -> Iterator[Reading]:
    raw = given.raw
    now = units.factor(table.position_unit or "m")
    for unit in units.LENGTH:
        factor = units.factor(unit)
        if factor != now:
            yield given._replace(
                words=f"positions in {unit}, taken for {table.position_unit or 'm'}",
                raw=replace(raw, position=raw.position * factor / now),
            )
    yield from _other_wrenches(given, table)
    yield from _other_turns(given, table, degrees)
    yield from _other_axes(given)
    for words, factor in (
        ("the rod's diameter, taken for its radius", 1 / 16),
        ("half of the rod's radius, taken for it", 16.0),
    ):
        yield given._replace(
            words=words,
            rod=replace(given.rod, bending_stiffness=factor * given.rod.bending_stiffness),
        )


def _other_wrenches(given: Reading, table: RecordingTable) -> Iterator[Reading]:
    """Other units of forces and torques, and their sign."""
    raw, force, torque = given.raw, table.force_unit or "N", table.torque_unit or "N m"
    for one in units.FORCE:
        for other in (*units.TORQUE, "lbf ft"):
            factors = (
                units.factor(one) / units.factor(force),
                units.factor(other) / units.factor(torque),
            )
            if factors == (1.0, 1.0):
                continue
            changed = [
                f"{name}s in {unit}, taken for {now}"
                for name, unit, now in (("force", one, force), ("torque", other, torque))
                if unit != now
            ]
            yield given._replace(
                words=" and ".join(changed),
                raw=replace(raw, force=raw.force * factors[0], torque=raw.torque * factors[1]),
            )
    sign: WrenchSign = "on_rod" if given.sensor.wrench == "on_sensor" else "on_sensor"
    yield given._replace(
        words=f"a wrench of the other sign (wrench = {sign!r} in [sensor])",
        sensor=replace(given.sensor, wrench=sign),
    )


def _other_turns(
    given: Reading, table: RecordingTable, degrees: Callable[[], RawRecording]
) -> Iterator[Reading]:
    """Other orders of the quaternions, the turns back, other units of angles."""
    raw, form = given.raw, table.orientation_form
    orders = {"xyzw": ("w, x, y, z", 1, "wxyz"), "wxyz": ("x, y, z, w", -1, "xyzw")}
    turned: list[tuple[str, Float[np.ndarray, "n 4"]]] = [
        ("quaternions (or angles) of the turn from world to sensor", _back(raw.orientation))
    ]
    if form in orders:
        order, places, other = orders[form]
        # What was read as x, y, z, w came in another order: the file's numbers are put back, and
        # read in the other one.
        again = np.roll(raw.orientation, -places, axis=1)
        words = f"quaternions in the order {order} (orientation_form = {other!r} in [recording])"
        turned += [(words, again), (f"{words} of the turn from world to sensor", _back(again))]
    elif table.angle_unit in (None, "rad"):
        again = degrees().orientation
        again = np.where(np.isfinite(again).all(axis=1, keepdims=True), again, raw.orientation)
        turned.append(
            ("angles in degrees, taken for radians (angle_unit = 'deg' in [recording])", again)
        )
    else:
        vectors = np.degrees(Rotation.from_quat(raw.orientation).as_rotvec())
        turned.append(
            ("angles in radians, taken for degrees", Rotation.from_rotvec(vectors).as_quat())
        )
    for words, orientation in turned:
        if np.max(np.linalg.norm(rotation_vectors(raw.orientation, orientation), axis=1)) > _TURNED:
            yield given._replace(words=words, raw=replace(raw, orientation=orientation))


def _back(orientation: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
    return orientation * np.array([-1.0, -1.0, -1.0, 1.0])


def _other_axes(given: Reading) -> Iterator[Reading]:
    """A sensor that is turned on its flange, and axes of the wrench that are the world's, or the
    sensor's.
    """
    raw, sensor = given.raw, given.sensor
    if sensor.wrench_frame == "sensor":
        for axis, number in (("x", 0), ("y", 1), ("z", 2)):
            for angle in (180, 90, -90):
                turn = Rotation.from_rotvec(np.radians(angle) * np.eye(3)[number])
                words = f"a sensor turned by {angle}° about its {axis} axis"
                yield given._replace(
                    words=words,
                    raw=replace(
                        raw, force=_applied(turn, raw.force), torque=_applied(turn, raw.torque)
                    ),
                )
    other: WrenchFrame = "world" if sensor.wrench_frame == "sensor" else "sensor"
    if (
        np.max(
            np.linalg.norm(
                rotation_vectors(
                    np.broadcast_to([0.0, 0.0, 0.0, 1.0], raw.orientation.shape), raw.orientation
                ),
                axis=1,
            )
        )
        > _TURNED
    ):
        yield given._replace(
            words=f"a wrench in the axes of the {other} (wrench_frame in [sensor])",
            sensor=replace(sensor, wrench_frame=other),
        )


def _applied(turn: Rotation, vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return np.asarray(vectors @ turn.as_matrix().T)


def _turned_about(
    given: Reading, table: RecordingTable, degrees: Callable[[], RawRecording]
) -> str | None:
    """A whisk or an arc turns the sensor about an axis: its way is that of a point of a turning
    body, p = c + R a, which quaternions in another order spoil.
    """
    residual, extent, angle = _about_a_point(given.raw)
    if angle < _LEAST_TURN or extent < _LEAST_WAY * given.rod.length or residual < _SPOILT * extent:
        return None
    for other in _other_turns(given, table, degrees):
        again, _, turned = _about_a_point(other.raw)
        if turned > _LEAST_TURN and again < _TRUE * residual:
            return f"{other.words}? With them the sensor turns about a point to {again:.2g} m, as on an arc, and as the file is read to {residual:.2g} m"
    return None


def _about_a_point(raw: RawRecording) -> tuple[float, float, float]:
    """Residual and extent of the sensor's way [m] about a point that it turns about as one body,
    and by how much it turns [rad].
    """
    rows = np.linspace(0, len(raw.time) - 1, min(len(raw.time), _ROWS)).astype(int)
    position, orientation = raw.position[rows], raw.orientation[rows]
    turns = rotation_vectors(np.broadcast_to(orientation[:1], orientation.shape), orientation)
    design = np.concatenate(
        [np.broadcast_to(np.eye(3), (len(rows), 3, 3)), rotation_matrices(orientation)], axis=2
    ).reshape(-1, 6)
    flat = position.reshape(-1)
    left = flat - design @ np.linalg.lstsq(design, flat, rcond=None)[0]
    extent = float(np.sqrt(np.mean((position - position.mean(axis=0)) ** 2)))
    return float(np.sqrt(np.mean(left**2))), extent, float(np.linalg.norm(turns, axis=1).max())


def _half_turned(given: Reading, found: Inspection, table: RecordingTable) -> list[Fault]:
    """Quaternions next to (1, 0, 0, 0) throughout: half a turn about x, or w first; told by the
    work where the sweep tells, else asked for.
    """
    if (
        "orientation_form" in table.model_fields_set
        or table.orientation_form != "xyzw"
        or np.abs(given.raw.orientation[:, 0]).min() < _HALF_TURN
    ):
        return []
    again = given._replace(
        raw=replace(given.raw, orientation=np.roll(given.raw.orientation, -1, axis=1))
    )
    works = _works(again, found)
    if not works or not all(_sound(work, _WITH_FRICTION) for work in works):
        return []
    return [
        _fault(
            "qx = 1 throughout: half a turn about x, or quaternions written w first? The sweep fits both; state orientation_form in [recording]",
            found,
        )
    ]
