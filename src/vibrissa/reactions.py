"""Support reactions: the only thing that forward, sensor and inverse share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import cross_matrices, rotation_vectors
from vibrissa.tolerances import SetupErrors
from vibrissa.trail import Index, Trail, first_axis

# Fraction of the largest entry: rotated covariances are symmetric and definite only to rounding.
_ROUNDING = 1e-9
VELOCITY_SPAN = 0.05
"""Time [s] over which the clamp's velocity is taken: 10 µm of pose noise then give 0.3 mm/s, and
few motions change much within it.
"""


@dataclass(frozen=True, eq=False)
class Reactions:
    """What the clamp exerts on the rod, at known clamp poses.

    Attributes
    ----------
    trail
        Clamp poses (n, …) or (m, n, …).
    force
        f0 (…, 3) [N], world axes, on the rod. A row of NaN marks a position without a value.
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
        For an error of the robot's orientation, which turns rod and reactions as one body:
        covariance of its rotation vector, world axes (3, 3) [rad²], and the points about which it
        turns (…, 3). Both or None.
    setup_errors
        Errors that all rows share, of rod, clamp, gains and clocks, as stated by the setup, or None
        if it states none.
    misread
        What was found on reading that discredits them as a whole, such as other units or axes, one
        line each: none of their contacts is to be trusted.
    velocity
        Of the clamp point and of the rotation of its axes (…, 6), world axes, per second, for poses
        that may come late; None to take it from trail and time.

    Raises
    ------
    ValueError
        If shapes do not match, times do not increase, `covariance` is not symmetric and positive
        definite, `position_covariance` or `rotation_covariance` is not positive semidefinite, or
        only one of `rotation_covariance` and `rotation_center` is given.
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
        force: "ArrayLike",
        moment: "ArrayLike",
        time: "ArrayLike | None" = None,
        covariance: "ArrayLike | None" = None,
        position_covariance: "ArrayLike | None" = None,
        rotation_covariance: "ArrayLike | None" = None,
        rotation_center: "ArrayLike | None" = None,
        setup_errors: SetupErrors | None = None,
        velocity: "ArrayLike | None" = None,
        misread: tuple[str, ...] = (),
    ) -> None:
        given, fields = locals(), vars(self)
        if (rotation_covariance is None) != (rotation_center is None):
            raise ValueError(
                "rotation_covariance and rotation_center: one is given without the other; "
                "allowed are both or none"
            )
        fields |= {"trail": trail, "setup_errors": setup_errors, "misread": misread}
        for name, own in _BY_ROW.items():
            shape = trail.shape + own
            fields[name] = None if given[name] is None else _rows(given[name], name, shape)
        for name, shape in (
            ("covariance", trail.shape),
            ("position_covariance", ()),
            ("rotation_covariance", ()),
        ):
            fields[name] = None if given[name] is None else _covariance(given[name], name, shape)

    def __repr__(self) -> str:
        """Return five lines: poses, loads, time, errors, and doubts."""
        loads = (np.linalg.norm(part, axis=-1) for part in (self.force, self.moment))
        force, moment = (
            f"{np.nanmax(load):.4g}" if np.isfinite(load).any() else "unknown" for load in loads
        )
        time = (
            "unknown" if self.time is None else f"{self.time.min():.6g} to {self.time.max():.6g} s"
        )
        return (
            f"Reactions at {self.trail.position.size // 3} poses {self.trail.shape}\n"
            f"  largest force: {force}, largest moment: {moment}\n"
            f"  time: {time}\n"
            f"  noise: {'un' * (self.covariance is None)}known, errors of the setup: "
            f"{'un' * (self.setup_errors is None)}known\n"
            f"  misread: {'; '.join(self.misread) or 'no'}"
        )

    def __getitem__(self, index: Index) -> "Reactions":
        """Rows of one trail, or some of several trails, with all that belongs to them; what all
        rows share is kept.

        The index applies to the first axis: positions of one trail (n, …), or trails of several (m,
        n, …). A slice, a mask or an array of numbers keeps that axis; a number gives one position
        of a trail as reactions of one row, or one trail of several. With `time`, positions must
        stay in order.

        Raises
        ------
        IndexError
            If the index is out of range, or has more than one axis.
        ValueError
            If nothing is left, or times do not increase.
        """
        trail, axes = self.trail[index], len(self.trail.shape)
        chosen = first_axis(index, self.trail.shape)
        rows = {name: getattr(self, name) for name in (*_BY_ROW, "covariance")}
        if self.time is not None and axes == 1:
            # A single row does not determine it.
            rows["velocity"] = self.clamp_velocity()
        for name, value in rows.items():
            if value is not None and value.ndim == axes + len(_BY_ROW.get(name, (6, 6))):
                rows[name] = value[chosen]
        return replace(self, trail=trail, **rows)

    @property
    def wrench(self) -> Float[np.ndarray, "*trail n 6"]:
        """Force and moment side by side."""
        return np.concatenate([self.force, self.moment], axis=-1)

    @property
    def clamp_work(self) -> Float[np.ndarray, "*trail steps"]:
        """Work (…) [J] done by the clamp on the rod from each row to the next, by the trapezoidal
        rule.
        """
        wrench = self.wrench
        mean = (wrench[..., 1:, :] + wrench[..., :-1, :]) / 2
        return np.asarray(np.sum(mean * self.trail.steps, axis=-1))

    def clamp_velocity(self) -> Float[np.ndarray, "*trail n 6"]:
        """As given, or averaged over 50 ms about each row, at least from the row before to the one
        after; zero where trail and time do not determine it.
        """
        if self.velocity is not None:
            return self.velocity
        if self.time is None or self.trail.count < 2:
            return np.zeros((*self.trail.shape, 6))
        by_trail = np.vectorize(velocities, signature="(n),(n,p),(n,q)->(n,v)")
        return np.asarray(by_trail(self.time, self.trail.position, self.trail.orientation))

    @property
    def single_contact_residual(self) -> Float[np.ndarray, "*trail n"]:
        """m0·f0 / (‖m0‖ ‖f0‖): zero where one contact force explains the reactions (mechanics.md,
        "Statics gives a line"); NaN without a force.
        """
        scale = np.linalg.norm(self.force, axis=-1) * np.linalg.norm(self.moment, axis=-1)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sum(self.force * self.moment, axis=-1) / scale)


def turned_covariance(
    rotation: Float[np.ndarray, "3 3"], arm: Float[np.ndarray, "*trail n 3"]
) -> Float[np.ndarray, "*trail n 3 3"]:
    """Covariance of δθ × arm for vectors (…, 3) and a rotation vector δθ with this covariance."""
    crossed = cross_matrices(arm)
    return np.asarray(np.swapaxes(crossed, -1, -2) @ rotation @ crossed)


def velocities(
    time: Float[np.ndarray, "n"],
    position: Float[np.ndarray, "n 3"],
    orientation: Float[np.ndarray, "n 4"],
) -> Float[np.ndarray, "n 6"]:
    """Velocities of poses and of their rotation, over 50 ms about each row."""
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


_BY_ROW: dict[str, tuple[int, ...]] = {
    "force": (3,),
    "moment": (3,),
    "time": (),
    "rotation_center": (3,),
    "velocity": (6,),
}
"""Fields with a value for each row, and the shape of one."""


def _rows(value: ArrayLike, name: str, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    array = finite_array(value, name) if name == "time" else np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; allowed is {shape}, as the trail has")
    for falling in np.argwhere(np.diff(array, axis=-1) <= 0).tolist() if name == "time" else ():
        raise ValueError(
            f"time{falling} = {array[tuple(falling)]} is not before the next; allowed are "
            "increasing times"
        )
    return array


def _covariance(value: ArrayLike, name: str, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    definite = name == "covariance"
    kind, size = ("definite", 6) if definite else ("semidefinite", 3)
    array = finite_array(value, name, last=size)
    if array.shape not in ((size, size), (*shape, size, size)):
        raise ValueError(
            f"{name} has shape {array.shape}; allowed is {(size, size)} or {(*shape, size, size)}"
        )
    rounding = _ROUNDING * np.abs(array).max()
    uneven = np.abs(array - np.swapaxes(array, -1, -2)).max()
    least = np.linalg.eigvalsh(array)[..., 0].min()
    if uneven > rounding or (least <= 0 if definite else least < -rounding):
        wrong = f"differs from its transpose by {uneven:.3g}"
        if uneven <= rounding:
            wrong = f"has the least eigenvalue {least:.3g}"
        raise ValueError(f"{name} {wrong}; allowed is symmetric and positive {kind}")
    return array
