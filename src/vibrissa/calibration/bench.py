"""Everything a calibration may change, as one tree of numbers, and how it applies to a setup."""

from dataclasses import replace
from typing import Any, NamedTuple, Protocol, TypeVar, cast, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.calibration.form import Form, Shape, adjusted, shape_of
from vibrissa.geometry.rotation import rotation_matrices, turning_axis_to
from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.model import RodModel
from vibrissa.mechanics.models import spatial
from vibrissa.numerics.compiled import compiled
from vibrissa.numerics.rotation import rotation_matrix
from vibrissa.rod import Rod
from vibrissa.sensor import Sensor
from vibrissa.surfaces import Surface
from vibrissa.surfaces.base import Placed


@runtime_checkable
class SetupLike(Protocol):
    """A dataclass with rod, sensor and surface, like `vibrissa.Setup`."""

    @property
    def rod(self) -> Rod:
        """The rod."""

    @property
    def sensor(self) -> Sensor:
        """The sensor with its mount."""

    @property
    def surface(self) -> Surface | None:
        """The object."""


SetupType = TypeVar("SetupType", bound=SetupLike)


class Step(NamedTuple):
    """A small change of the bench; also holds its numbers, or derivatives by them (…, entries)."""

    stiffness: Float[Any, "*rows 1"]
    """ln EI."""
    length: Float[Any, "*rows 1"]
    """ln L."""
    clamp: Float[Any, "*rows 3"]
    """Shift of the clamp point, sensor axes."""
    tilt: Float[Any, "*rows 3"]
    """Rotation vector of the clamp, in its own axes."""
    gain: Float[Any, "*rows 6"]
    """ln of the gains."""
    shift: Float[Any, "*rows 3"]
    """Shift of the object, world axes."""
    turn: Float[Any, "*rows 3"]
    """Rotation vector of the object about `Bench.pivot`, world axes."""
    standoff: Float[Any, "*rows 1"]
    taper: Float[Any, "*rows t"]
    """None where the closed form is used, like the next two."""
    rest: Float[Any, "*rows r"]
    """Rest curvature, along and across the direction in which the rod is given to be bent."""
    support: Float[Any, "*rows s"]
    """ln of a pivot's stiffnesses, about the clamp's axes."""


LOGARITHMIC = ("stiffness", "length", "gain", "support")
_SIZES = (1, 1, 3, 3, 6, 3, 3, 1)
_OF_FORM = (1, 2, 3)
NO_STEP = Step(*(np.zeros(size) for size in (*_SIZES, 0, 0, 0)))
"""Of a rod in closed form."""
_NO_STEP_OF_ANY = Step(*(np.zeros(size) for size in (*_SIZES, *_OF_FORM)))


class Bench(NamedTuple):
    """Rod, mount, sensor and the object's place, in units of the rod."""

    stiffness: Float[Any, ""]
    length: Float[Any, ""]
    clamp: Float[Any, "3"]
    """Clamp point in the sensor frame."""
    axes: Float[Any, "3 3"]
    """Clamp axes as columns, in the sensor frame."""
    wrench_point: Float[Any, "3"]
    """Point about which torques are given, in the sensor frame."""
    gain: Float[Any, "6"]
    """Ratio of the readings to those of the sensor as given."""
    shift: Float[Any, "3"]
    """Displacement of the object from where it is given, world axes."""
    turn: Float[Any, "3 3"]
    """Rotation of the object about `pivot`, applied before that."""
    pivot: Float[Any, "3"]
    standoff: Float[Any, ""]
    """Distance of the centre line from the object as given, at the contact."""
    shape: Shape
    """What may change about the rod's form."""
    form: Form | None = None
    """The rod as given, in a form that may change; None for the closed form."""

    @property
    def center(self) -> Float[np.ndarray, "3"]:
        """Where the pivot is now."""
        return np.asarray(self.pivot + self.shift)

    @property
    def move(self) -> Float[Any, "3"]:
        """Translation of the object after its rotation about the origin."""
        return self.pivot + self.shift - self.turn @ self.pivot

    def placed(self, surface: Surface) -> Surface:
        """The object at its present pose."""
        return Placed(surface, self.turn, self.move)

    @property
    def model(self) -> RodModel:
        """How the rod bends, in its own units."""
        if self.form is None:
            return Elastica()
        rod = replace(self.form.rod, length=self.length, bending_stiffness=self.stiffness)
        return spatial(self.shape.applied(rod), nodes=self.form.nodes)

    @property
    def loaded(self) -> bool:
        """Whether the rod carries loads along it."""
        return self.form is not None and self.form.rod.loads is not None

    @property
    def no_step(self) -> Step:
        """A step that changes nothing."""
        return NO_STEP if self.form is None else _NO_STEP_OF_ANY

    def rod(self, given: Rod) -> Rod:
        """The rod with these values."""
        rod = replace(given, length=float(self.length), bending_stiffness=float(self.stiffness))
        return rod if self.form is None else adjusted(rod, self.shape)

    def setup(self, given: SetupType, surface: Surface | None) -> SetupType:
        """The setup with these values; what a file said about an earlier calibration is dropped."""
        fx, fy, fz, tx, ty, tz = np.asarray(given.sensor.gain * self.gain).tolist()
        sensor = given.sensor.updated(
            clamp_position=np.asarray(self.clamp),
            clamp_orientation=Rotation.from_matrix(np.asarray(self.axes)).as_quat(),
            gain=(fx, fy, fz, tx, ty, tz),
        )
        parts: dict[str, Any] = {"rod": self.rod(given.rod), "sensor": sensor, "surface": surface}
        if hasattr(given, "calibration"):
            parts["calibration"] = None
        return cast(SetupType, replace(cast(Any, given), **parts))

    def numbers(self, given: Sensor) -> Step:
        """EI, L, clamp point, rotation of the clamp from the given one, gains, shift and rotation
        of the object, standoff, taper, rest curvature and its roll, stiffnesses of a pivot.
        """
        turned = rotation_matrices(given.clamp_orientation).T @ np.asarray(self.axes)
        tilt, turn = Rotation.from_matrix(np.stack([turned, self.turn])).as_rotvec()
        one, gain = np.atleast_1d, np.asarray(given.gain * self.gain)
        return Step(
            one(self.stiffness), one(self.length), self.clamp, tilt, gain, self.shift, turn,
            one(self.standoff), one(self.shape.taper), self.shape.polar, self.shape.support,
        )  # fmt: skip

    def unrolled(self, given: Sensor) -> "Bench":
        """With the clamp's axes rotated from the given ones the shortest way, without roll."""
        axes = rotation_matrices(given.clamp_orientation)
        shortest = turning_axis_to(axes.T @ np.asarray(self.axes)[:, 2])
        return self._replace(axes=axes @ rotation_matrices(shortest))


def bench_of(rod: Rod, sensor: Sensor, form: Form | None = None) -> Bench:
    """The bench as a setup states it, with a rod whose form may change if that is given."""
    return Bench(
        stiffness=np.asarray(rod.bending_stiffness),
        length=np.asarray(rod.length),
        clamp=sensor.clamp_position,
        axes=rotation_matrices(sensor.clamp_orientation),
        wrench_point=np.asarray(sensor.wrench_point, dtype=np.float64),
        gain=np.ones(6),
        shift=np.zeros(3),
        turn=np.eye(3),
        pivot=np.zeros(3),
        standoff=np.asarray(0.0),
        shape=shape_of(rod),
        form=form,
    )


def moved(bench: Bench, step: Step) -> Bench:
    """The bench after a step; smooth in the step."""
    return bench._replace(
        stiffness=bench.stiffness * jnp.exp(step.stiffness[0]),
        length=bench.length * jnp.exp(step.length[0]),
        clamp=bench.clamp + step.clamp,
        axes=bench.axes @ _rotation(step.tilt),
        gain=bench.gain * jnp.exp(step.gain),
        shift=bench.shift + step.shift,
        turn=_rotation(step.turn) @ bench.turn,
        standoff=bench.standoff + step.standoff[0],
        shape=bench.shape.moved(step.taper, step.rest, step.support),
    )


moved_at_once = compiled(moved)
"""The same, for use outside compiled code."""


def _rotation(vector: Float[Any, "3"]) -> Float[Array, "3 3"]:
    """Matrix of a rotation vector, rational in it: right to 1e-4 for the few degrees met here."""
    return rotation_matrix(jnp.append(vector / 2, 1.0))
