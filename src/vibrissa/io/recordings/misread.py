"""Files that are read without an error and yet misread: units, quaternion order, signs and axes.

The clamp's work and the rod's bending energy are two routes to one number
(`vibrissa.inverse.work`). If they contradict each other, each known mistake is undone in turn; a
mistake is named if undoing it reconciles the two, keeps the contacts on the rod and leaves the
noise at rest as stated.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product
from operator import itemgetter

import numpy as np
from scipy.spatial.transform import Rotation

from vibrissa.inverse.work import ClampWork, clamp_work
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.recordings.units import ALLOWED, factor
from vibrissa.io.setup import Setup
from vibrissa.sensor import Fault, FaultKind, Inspection, RawRecording, Sensor
from vibrissa.sensor.raw import CHANNELS
from vibrissa.sensor.sensor import WrenchFrame, WrenchSign
from vibrissa.sensor.tare import Tare
from vibrissa.sensor.units import Reading

# Energy gained, relative to the largest: correct data without friction give a few thousandths.
_SOUND = 0.03
_DEVIATIONS = 6.0
# Work over energy during first loading: a smaller ratio is impossible, a larger one takes friction.
_FRICTIONLESS, _WITH_FRICTION = (0.95, 1.05), (0.95, 2.5)
# An interpretation that implies friction is doubted if another implies none: in good recordings
# with friction the ratio is 1.1 or more.
_DOUBTED = 1.1
# Root mean square of work less energy over the largest energy, without friction: 0.004 where the
# right mistake is undone, 0.47 where a wrong one fits the first loading by chance.
_MISFIT = 0.2
# The same below which nothing else is sought, and trials to find a stiffness that gives it.
_FITS, _MOST_TRIALS = 0.03, 8
# More than three guesses help nobody.
_MOST_NAMED = 3
# The stated noise at rest may be off by this factor; the units to be distinguished differ by more.
_NOISE = 3.0
# Radians: orientations closer to each other than a robot's error count as the same.
_SAME = 5e-3
# qx of half a turn about x, to within 16 degrees: a sensor may be mounted slightly askew.
_HALF_TURN = 0.99
# Rows of the sensor's path: enough for a fit of six numbers.
_ROWS = 400
# Radians, and fractions of the rod's length: less does not determine an axis.
_LEAST_TURN, _LEAST_WAY = 0.1, 0.02
# Fraction of the path's extent, and of the residual as read: pose noise is far below both.
_SPOILT, _TRUE = 0.1, 0.05


def misread_faults(
    found: Inspection, setup: Setup, degrees: Callable[[], RawRecording]
) -> list[Fault]:
    """A finding that names the most likely mistakes, if the recording as read contradicts itself
    and undoing one of them resolves it.

    Parameters
    ----------
    found
        Inspection of the recording as read.
    setup
        Rod and sensor as stated, and how the file was read.
    degrees
        Reads the file again with its angles in degrees, row for row.
    """
    if found.unusable or found.tare is None or not found.usable.any():
        return []
    given, table = Reading("", found.cleaned, found.sensor, setup.rod), setup.recording
    recording = _Recording(given, found.tare, setup.sensor, table or RecordingTable(), degrees)
    text = recording.turned_about() or recording.by_work()
    return [Fault.over(CHANNELS, FaultKind.UNITS, given.raw.time, text)] if text else []


@dataclass(frozen=True, eq=False)
class _Recording:
    """A recording as it was read, and other ways to interpret it."""

    given: Reading
    tare: Tare
    stated: Sensor
    table: RecordingTable
    degrees: Callable[[], RawRecording]

    def works(self, reading: Reading) -> list[ClampWork]:
        """Work and energy over the contacts of an interpretation; empty if these cannot be contacts
        on this rod.
        """
        reactions = reading.reactions(self.tare)
        return [] if reactions is None else clamp_work(reading.rod, reactions)

    def sound(self, reading: Reading, allowed: tuple[float, float]) -> list[ClampWork]:
        """The same if work and energy agree in all of them, else empty."""
        works = self.works(reading)
        for work in works:
            slack = _DEVIATIONS * work.ratio_deviation
            if not (
                work.gained < _SOUND + _DEVIATIONS * work.deviation
                and allowed[0] - slack < work.ratio < allowed[1] + slack
                and (work.misfit < _MISFIT or work.ratio > _DOUBTED)
            ):
                return []
        return works

    def by_work(self) -> str | None:
        """What reconciles the clamp's work with the rod's energy if they disagree; if they agree,
        a question about quaternions near (1, 0, 0, 0) that the work leaves open.
        """
        works = self.works(self.given)
        if not works:
            return None
        worst = max(works, key=lambda work: abs(np.log(max(abs(work.ratio), 1e-9))) + work.gained)
        doubted = worst.ratio > _DOUBTED + _DEVIATIONS * worst.ratio_deviation
        if not doubted and not any(work.impossible for work in works):
            return self.half_turned()
        low, high = _WITH_FRICTION
        gross = not low / high < worst.ratio < high
        likely = self.likely(_WITH_FRICTION if gross else _FRICTIONLESS)
        right = [reading for reading in likely if self.fits(reading)]
        if not gross:
            # A taper or a wrong stiffness is off by as much: the setup check tells those apart.
            likely = right
        elif not right:
            likely = self.other_stiffness(worst.ratio) or likely
        if not likely:
            return None
        best = max(self.works(likely[0]), key=lambda work: float(work.energy.max()))
        return (
            f"{' or '.join(reading.words for reading in likely)}? The clamp's work is "
            f"{worst.ratio:.3g} times the rod's bending energy as the file is read, and "
            f"{best.ratio:.3g} times with that undone"
        )

    def likely(self, allowed: tuple[float, float]) -> list[Reading]:
        """Other interpretations in which work and energy agree, best first."""
        scored = [
            (max(work.misfit for work in works), reading)
            for reading in self.readings()
            if reading.is_plausible(self.tare, self.stated, _NOISE)
            and (works := self.sound(reading, allowed))
        ]
        scored.sort(key=itemgetter(0))
        good = [reading for misfit, reading in scored if misfit < 2 * scored[0][0] + _SOUND / 2]
        return good[:_MOST_NAMED]

    def fits(self, reading: Reading) -> bool:
        """Whether work and energy agree throughout, without friction."""
        return all(work.misfit < _FITS for work in self.works(reading))

    def other_stiffness(self, ratio: float) -> list[Reading]:
        """The recording with the bending stiffness that makes work and energy agree throughout, if
        there is one.
        """
        rod = self.given.rod
        for _ in range(_MOST_TRIALS):
            if not ratio > 0:
                break
            rod = replace(rod, bending_stiffness=rod.bending_stiffness / ratio)
            off = self.given.rod.bending_stiffness / rod.bending_stiffness
            how = f"{off:.2g} times too large" if off > 1 else f"{1 / off:.2g} times too small"
            other = self.given._replace(words=f"a bending stiffness (EI) {how}", rod=rod)
            plausible = other.is_plausible(self.tare, self.stated, _NOISE)
            if not (plausible and (works := self.works(other))):
                break
            if self.fits(other):
                return [other]
            ratio = max(works, key=lambda work: float(work.energy.max())).ratio
        return []

    def half_turned(self) -> str | None:
        """Quaternions near (1, 0, 0, 0) throughout are half a turn about x, or have w first: the
        work decides if the sweep allows it, else the user is asked.
        """
        orientation = self.given.raw.orientation
        stated = "orientation_form" in self.table.model_fields_set
        if stated or np.abs(orientation[:, 0]).min() < _HALF_TURN:
            return None
        w_first = self.given.changed("", orientation=np.roll(orientation, -1, axis=1))
        if not self.sound(w_first, _WITH_FRICTION):
            return None
        return (
            "qx = 1 throughout: half a turn about x, or quaternions written w first? The sweep "
            "fits both; state orientation_form in [recording]"
        )

    def turned_about(self) -> str | None:
        """A whisk or an arc turns the sensor about an axis, so its path is that of a point on a
        rotating body, p = c + R a; quaternions in the wrong order violate this.
        """
        residual, extent, angle = _about_a_point(self.given.raw)
        least = _LEAST_WAY * self.given.rod.length
        if angle < _LEAST_TURN or extent < least or residual < _SPOILT * extent:
            return None
        for other in self.other_turns():
            again, _, turned = _about_a_point(other.raw)
            if turned > _LEAST_TURN and again < _TRUE * residual:
                return (
                    f"{other.words}? With them the sensor turns about a point to {again:.2g} m, "
                    f"as on an arc, and as the file is read to {residual:.2g} m"
                )
        return None

    def readings(self) -> Iterator[Reading]:
        """The recording with each known mistake undone: units and sign, orientations, axes, and
        diameter and radius confused.
        """
        given, raw, sensor, table = self.given, self.given.raw, self.given.sensor, self.table
        for words, scale in _units("position", table):
            if words:
                yield given.changed(words, position=raw.position * scale)
        for (forces, force), (torques, torque) in product(
            _units("force", table), _units("torque", table)
        ):
            if words := " and ".join(filter(None, (forces, torques))):
                yield given.changed(words, force=raw.force * force, torque=raw.torque * torque)
        sign: WrenchSign = "on_rod" if sensor.wrench == "on_sensor" else "on_sensor"
        words = f"a wrench of the other sign (wrench = {sign!r} in [sensor])"
        yield given._replace(words=words, sensor=replace(sensor, wrench=sign))
        for first, second in combinations("xyz", 2):
            order = ["xyz".index({first: second, second: first}.get(one, one)) for one in "xyz"]
            words = f"{first} and {second} of forces and torques swapped"
            yield given.changed(words, force=raw.force[:, order], torque=raw.torque[:, order])
        yield given.changed("forces of the other sign", force=-raw.force)
        yield given.changed("torques of the other sign", torque=-raw.torque)
        yield from self.other_turns()
        if sensor.wrench_frame == "sensor":
            for axis, angle in product("xyz", (180, 90, -90)):
                turn = Rotation.from_euler(axis, angle, degrees=True).as_matrix().T
                words = f"a sensor turned by {angle}° about its {axis} axis"
                yield given.changed(words, force=raw.force @ turn, torque=raw.torque @ turn)
                words = f"poses turned by {angle}° about the sensor's {axis} axis"
                poses = (Rotation.from_quat(raw.orientation) * Rotation.from_matrix(turn)).as_quat()
                yield given.changed(words, orientation=poses)
        frame: WrenchFrame = "world" if sensor.wrench_frame == "sensor" else "sensor"
        if Rotation.from_quat(raw.orientation).magnitude().max() > _SAME:
            words = f"a wrench in the axes of the {frame} (wrench_frame in [sensor])"
            yield given._replace(words=words, sensor=replace(sensor, wrench_frame=frame))
        # EI is proportional to the fourth power of the radius.
        for words, scale in (
            ("the rod's diameter, taken for its radius", 1 / 16),
            ("half of the rod's radius, taken for it", 16.0),
        ):
            stiffness = scale * given.rod.bending_stiffness
            yield given._replace(words=words, rod=replace(given.rod, bending_stiffness=stiffness))

    def other_turns(self) -> Iterator[Reading]:
        """Other quaternion orders, inverse rotations, other angle units."""
        read, form = self.given.raw.orientation, self.table.orientation_form
        back = np.array([-1.0, -1.0, -1.0, 1.0])
        inverse = "of the turn from world to sensor"
        turned = {f"quaternions (or angles) {inverse}": back * read}
        if form in {"xyzw", "wxyz"}:
            # The file's order is restored, and read as the other one.
            other, places = ("wxyz", -1) if form == "xyzw" else ("xyzw", 1)
            again = np.roll(read, places, axis=1)
            words = (
                f"quaternions in the order {', '.join(other)} "
                f"(orientation_form = {other!r} in [recording])"
            )
            turned |= {words: again, f"{words} {inverse}": back * again}
        elif self.table.angle_unit == "deg":
            vectors = np.degrees(Rotation.from_quat(read).as_rotvec())
            again = Rotation.from_rotvec(vectors).as_quat()
            turned["angles in radians, taken for degrees"] = again
        else:
            again = self.degrees().orientation
            words = "angles in degrees, taken for radians (angle_unit = 'deg' in [recording])"
            turned[words] = np.where(np.isfinite(again).all(axis=1, keepdims=True), again, read)
        for words, orientation in turned.items():
            between = Rotation.from_quat(read).inv() * Rotation.from_quat(orientation)
            if between.magnitude().max() > _SAME:
                yield self.given.changed(words, orientation=orientation)


def _units(key: str, table: RecordingTable) -> Iterator[tuple[str, float]]:
    """Words for each unit that the numbers may be in, empty for the one they were read in, and its
    factor.
    """
    allowed = ALLOWED[key]
    now = getattr(table, f"{key}_unit") or allowed[0]
    for unit in (*allowed, "lbf ft") if key == "torque" else allowed:
        words = f"{key}s in {unit}, taken for {now}" * (unit != now)
        yield words, factor(unit) / factor(now)


def _about_a_point(raw: RawRecording) -> tuple[float, float, float]:
    """Fit a rigid rotation about a point to the sensor's path: residual and extent of the path [m],
    and the angle turned [rad].
    """
    rows = np.linspace(0, len(raw.time) - 1, min(len(raw.time), _ROWS)).astype(int)
    position, turns = raw.position[rows], Rotation.from_quat(raw.orientation[rows])
    matrices, turned = turns.as_matrix(), (turns[0].inv() * turns).magnitude()
    # Subtracting the means of both sides eliminates c.
    way = (position - position.mean(axis=0)).ravel()
    design = (matrices - matrices.mean(axis=0)).reshape(-1, 3)
    left = way - design @ np.linalg.lstsq(design, way, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2))), float(way.std()), float(turned.max())
