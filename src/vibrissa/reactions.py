"""Support reactions: the only thing that forward, sensor and inverse share."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import rotation_vectors
from vibrissa.tolerances import SetupErrors
from vibrissa.trail import Trail

_WRENCH = 6
_ROUNDING = 1e-9
VELOCITY_SPAN = 0.05
"""Time [s] over which the clamp's velocity is taken: 10 µm of noise of the pose are 0.3 mm/s then,
and few motions change much within it.
"""


@dataclass(frozen=True, eq=False)
class Reactions:
    """What the clamp exerts on the rod, at known clamp poses.

    Attributes
    ----------
    trail
        Clamp poses (n, …) or (m, n, …).
    force
        f0 (…, 3) [N], world axes, on the rod. A row of NaN stands for a position without a value.
    moment
        m0 (…, 3) [N m] about the clamp point, world axes, on the rod.
    time
        (…) [s], or None.
    covariance
        Of (force, moment), (6, 6) or (…, 6, 6), world axes, or None where the sensor's noise is not
        known.
    position_covariance
        Of the clamp point (3, 3) [m²], or None.
    rotation_covariance, rotation_center
        Of an error of the robot's orientation, which turns rod and reactions as one body: of its
        rotation vector, world axes (3, 3) [rad²], and the points about which it turns (…, 3). Both
        or None.
    setup_errors
        What all rows share: errors of rod, clamp, gains and clocks as stated by the setup, or None
        where it states none.
    misread
        What reading them found against them as a whole, such as other units or axes, a line each:
        no contact of theirs is to be trusted.
    velocity
        Of the clamp point and of its axes' rotation (…, 6), world axes, a second, for poses that
        may come late; None to take it from trail and time.

    Raises
    ------
    ValueError
        If shapes do not fit, times do not increase, `covariance` is not symmetric and positive
        definite, `position_covariance` or `rotation_covariance` not positive semidefinite, or of
        rotation's covariance and centre one is given without the other.
    """

    trail: Trail
    force: Float[np.ndarray, "*trail n 3"]
    moment: Float[np.ndarray, "*trail n 3"]
    time: Float[np.ndarray, "*trail n"] | None = None
    covariance: Float[np.ndarray, "... 6 6"] | None = None
    position_covariance: Float[np.ndarray, "3 3"] | None = None
    rotation_covariance: Float[np.ndarray, "3 3"] | None = None
    rotation_center: Float[np.ndarray, "*trail n 3"] | None = None
    setup_errors: SetupErrors | None = None
    velocity: Float[np.ndarray, "*trail n 6"] | None = None
    misread: tuple[str, ...] = ()

    def __init__(
        self,
        trail: Trail,
        force: ArrayLike,
        moment: ArrayLike,
        time: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        position_covariance: ArrayLike | None = None,
        rotation_covariance: ArrayLike | None = None,
        rotation_center: ArrayLike | None = None,
        setup_errors: SetupErrors | None = None,
        velocity: ArrayLike | None = None,
        misread: tuple[str, ...] = (),
    ) -> None:
        shape = trail.shape
        self._set("trail", trail)
        self._set("force", _rows(force, "force", (*shape, 3)))
        self._set("moment", _rows(moment, "moment", (*shape, 3)))
        self._set("time", None if time is None else _increasing(time, shape))
        self._set(
            "covariance",
            None if covariance is None else _covariance(covariance, "covariance", _WRENCH, shape),
        )
        for name, value in (
            ("position_covariance", position_covariance),
            ("rotation_covariance", rotation_covariance),
        ):
            self._set(name, None if value is None else _covariance(value, name, 3, ()))
        if (rotation_covariance is None) != (rotation_center is None):
            raise ValueError(
                "rotation_covariance and rotation_center: one is given without the other; allowed are both or none"
            )
        self._set(
            "rotation_center",
            None
            if rotation_center is None
            else _rows(rotation_center, "rotation_center", (*shape, 3)),
        )
        self._set("setup_errors", setup_errors)
        self._set("misread", misread)
        self._set(
            "velocity", None if velocity is None else _rows(velocity, "velocity", (*shape, _WRENCH))
        )

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def pose_covariance(
        self, point: Float[np.ndarray, "*trail n 3"]
    ) -> Float[np.ndarray, "*trail n 3 3"] | None:
        """What errors of the robot's pose add to the covariance of points (…, 3) that are known
        from the clamp; None where they are not known.

        An error δθ of the orientation moves a point at d from the centre by δθ × d.
        """
        if self.position_covariance is None and self.rotation_covariance is None:
            return None
        moved = np.zeros((3, 3)) if self.position_covariance is None else self.position_covariance
        if self.rotation_covariance is None:
            return np.broadcast_to(moved, (*point.shape, 3))
        return moved + turned_covariance(self.rotation_covariance, point - self.rotation_center)

    def clamp_velocity(self) -> Float[np.ndarray, "*trail n 6"]:
        """As given, or over 50 ms about each row, at least from the row before to the one after;
        zero where there is no time to go by.
        """
        if self.velocity is not None:
            return self.velocity
        velocity = np.zeros((*self.trail.shape, _WRENCH))
        if self.time is not None and self.trail.count > 1:
            for index in np.ndindex(*self.trail.shape[:-1]):
                velocity[index] = velocities(
                    self.time[index], self.trail.position[index], self.trail.orientation[index]
                )
        return velocity

    @property
    def single_contact_residual(self) -> Float[np.ndarray, "*trail n"]:
        """m0·f0 / (‖m0‖ ‖f0‖): zero where one contact force explains the reactions (mechanics.md,
        "Statics alone"); NaN without a force.
        """
        scale = np.linalg.norm(self.force, axis=-1) * np.linalg.norm(self.moment, axis=-1)
        return np.divide(
            np.sum(self.force * self.moment, axis=-1),
            scale,
            out=np.full(scale.shape, np.nan),
            where=scale > 0,
        )


def turned_covariance(
    rotation: Float[np.ndarray, "3 3"], arm: Float[np.ndarray, "*trail n 3"]
) -> Float[np.ndarray, "*trail n 3 3"]:
    """Covariance of δθ × arm for vectors (…, 3) and a rotation vector δθ of this covariance."""
    crossed = np.cross(np.eye(3), arm[..., None, :])
    return np.asarray(np.swapaxes(crossed, -1, -2) @ rotation @ crossed)


def velocities(
    time: Float[np.ndarray, "n"],
    position: Float[np.ndarray, "n 3"],
    orientation: Float[np.ndarray, "n 4"],
) -> Float[np.ndarray, "n 6"]:
    """Of poses and of their rotation, over 50 ms about each row."""
    rows, half = np.arange(len(time)), VELOCITY_SPAN / 2
    first = np.maximum(np.minimum(np.searchsorted(time, time - half), rows - 1), 0)
    last = np.minimum(
        np.maximum(np.searchsorted(time, time + half, side="right") - 1, rows + 1), len(time) - 1
    )
    steps = np.concatenate(
        [position[last] - position[first], rotation_vectors(orientation[first], orientation[last])],
        axis=1,
    )
    return np.asarray(steps / (time[last] - time[first])[:, None])


def _rows(value: ArrayLike, name: str, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; allowed is {shape}, as the trail has")
    return array


def _increasing(value: ArrayLike, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    time = finite_array(value, "time")
    if time.shape != shape:
        raise ValueError(f"time has shape {time.shape}; allowed is {shape}, as the trail has")
    falling = np.argwhere(np.diff(time, axis=-1) <= 0)
    if falling.size:
        row = tuple(falling[0])
        raise ValueError(
            f"time{list(map(int, row))} = {time[row]} is not before the next; allowed are increasing times"
        )
    return time


def _covariance(
    value: ArrayLike, name: str, size: int, shape: tuple[int, ...]
) -> Float[np.ndarray, "..."]:
    array = finite_array(value, name, last=size)
    if array.shape not in ((size, size), (*shape, size, size)):
        raise ValueError(
            f"{name} has shape {array.shape}; allowed is {(size, size)} or {(*shape, size, size)}"
        )
    kind = "positive definite" if size == _WRENCH else "positive semidefinite"
    rounding = _ROUNDING * np.abs(array).max()
    uneven = np.abs(array - np.swapaxes(array, -1, -2)).max()
    if uneven > rounding:
        raise ValueError(
            f"{name} differs from its transpose by {uneven:.3g}; allowed is symmetric and {kind}"
        )
    least = np.linalg.eigvalsh(array)[..., 0]
    if not (np.all(least > 0) if size == _WRENCH else np.all(least >= -rounding)):
        raise ValueError(
            f"{name} has the least eigenvalue {float(np.min(least)):.3g}; allowed is symmetric and {kind}"
        )
    return array
