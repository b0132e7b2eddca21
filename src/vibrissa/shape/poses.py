"""Poses of a known object, and how far contacts contradict them.

A contact at p with normal n belongs to an object with signed distance d, turned by R and moved by
t, if d(q) = 0 and ∇d(q) = Rᵀn at q = Rᵀ(p − t): the equations of a surface fit (`noise`), with the
pose as unknown in place of the surface.

Motions are six numbers in world axes: a rotation vector about the contacts' middle, and a shift.
Small ones are the same as screws, whose exponential also describes large ones (Murray, Li & Sastry,
*A Mathematical Introduction to Robotic Manipulation*, 1994, section 2.3).
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from vibrissa.shape.noise import Noise, columns_of, lifted
from vibrissa.shape.sites import Gathered, deviations, single
from vibrissa.surfaces import Surface

_STEPS, _SETTLED = 30, 1e-6
"""Most steps, and the gain of the misfit, relative to itself and one, below which a pose has
settled.
"""
_DAMPING, _RIDGE = 1e-3, 1e-9
"""First damping, relative to each unknown's information, and to that of all for what is free."""
_STUCK = 1e6
"""Damping at which a pose that gains nothing is at a minimum, or at a kink."""


class Poses(NamedTuple):
    """Rotation matrices and shifts of some poses."""

    turn: Float[np.ndarray, "k 3 3"]
    shift: Float[np.ndarray, "k 3"]

    def moved(self, step: Float[np.ndarray, "k 6"], middle: Float[np.ndarray, "3"]) -> "Poses":
        """Each turned about a point, then shifted."""
        turn = Rotation.from_rotvec(step[:, :3]).as_matrix()
        shift = (turn @ (self.shift - middle)[..., None])[..., 0] + middle + step[:, 3:]
        return Poses(turn @ self.turn, shift)

    def screwed(self, screw: Float[np.ndarray, "k 6"], middle: Float[np.ndarray, "3"]) -> "Poses":
        """Each moved by the exponential of a screw."""
        left = _left(screw[:, :3])
        along = (left @ screw[:, 3:, None])[..., 0]
        return self.moved(np.concatenate([screw[:, :3], along], axis=1), middle)

    def screws(self, start: "Poses", middle: Float[np.ndarray, "3"]) -> Float[np.ndarray, "k 6"]:
        """Screws whose exponentials bring other poses here."""
        turn = self.turn @ np.swapaxes(start.turn, 1, 2)
        shift = (turn @ (middle - start.shift)[..., None])[..., 0] + self.shift - middle
        angle = Rotation.from_matrix(turn).as_rotvec()
        return np.concatenate([angle, np.linalg.solve(_left(angle), shift[..., None])[..., 0]], 1)

    def part(self, rows: Bool[np.ndarray, "k"] | Int[np.ndarray, "m"] | slice) -> "Poses":
        """Some of them."""
        return Poses(self.turn[rows], self.shift[rows])

    def own(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k n 3"]:
        """Points in each object's own axes."""
        return ((points - self.shift[:, None])[:, :, None] @ self.turn[:, None])[:, :, 0]

    def times(self, count: int) -> "Poses":
        """Each several times in a row."""
        return Poses(np.repeat(self.turn, count, axis=0), np.repeat(self.shift, count, axis=0))


class Equations(NamedTuple):
    """Residuals of all contacts in their errors for each pose, slopes by a motion whose shifts are
    in the extent, and the object's curvature at each contact, world axes.
    """

    residual: Float[np.ndarray, "k rows"]
    slope: Float[np.ndarray, "k rows u"]
    curvature: Float[np.ndarray, "k n 3 3"]

    @property
    def misfit(self) -> Float[np.ndarray, "k"]:
        """Sum of squared residuals."""
        return np.einsum("kr,kr->k", self.residual, self.residual)

    @property
    def information(self) -> Float[np.ndarray, "k u u"]:
        """About each motion."""
        return np.swapaxes(self.slope, 1, 2) @ self.slope

    @property
    def squares(self) -> Float[np.ndarray, "k n"]:
        """Squared residual of each contact."""
        return np.sum(self.residual.reshape(*self.curvature.shape[:2], 4) ** 2, axis=2)

    @property
    def gross(self) -> Bool[np.ndarray, "k n"]:
        """Contacts that are farther off than stated errors explain."""
        return self.squares > chi2.isf(_GROSS, 3)

    @property
    def robust(self) -> "Equations":
        """As if errors had Student's distribution: squares of residuals are minus twice the
        logarithm of its density, and contacts count less the farther they are off.
        """
        count, rows, unknowns = self.slope.shape
        square = np.maximum(self.squares, 1e-12)
        told, slope = students(square), (_STUDENT + 3) / (_STUDENT + square)
        residual = self.residual.reshape(count, -1, 4) * np.sqrt(told / square)[..., None]
        factor = slope * np.sqrt(square / told)
        slopes = self.slope.reshape(count, -1, 4, unknowns) * factor[..., None, None]
        return self._replace(
            residual=residual.reshape(count, rows), slope=slopes.reshape(count, rows, unknowns)
        )

    def part(self, rows: Bool[np.ndarray, "k"] | Int[np.ndarray, "m"] | slice) -> "Equations":
        """Those of some poses."""
        return Equations(*(values[rows] for values in self))


_STUDENT = 4.0
"""Degrees of freedom of the contacts' errors, as of a surface fit."""
_GROSS = 1e-3
"""Probability of a contact's squared residual below which it is an outlier."""


def students(square: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """What a contact with such a squared residual counts under Student's distribution."""
    return np.asarray((_STUDENT + 3) * np.log1p(square / _STUDENT))


def equations(surface: Surface, given: Gathered, poses: Poses) -> Equations:
    """Of all contacts for each pose."""
    own = poses.own(given.point)
    step = 1e-4 * given.extent
    moved = [own + sign * step * axis for axis in np.eye(3) for sign in (1, -1)]
    normals = surface.normal(np.stack([own, *moved]))
    bent = np.stack([normals[i] - normals[i + 1] for i in (1, 3, 5)], axis=-1) / (2 * step)
    told = Told(surface.distances(own), normals[0], bent)
    return equations_of(told, given, poses)


class Told(NamedTuple):
    """What an object says of contacts in each pose, in its own axes: distances, normals and their
    derivatives by place, and by further unknowns.
    """

    distance: Float[np.ndarray, "k n"]
    normal: Float[np.ndarray, "k n 3"]
    curvature: Float[np.ndarray, "k n 3 3"]
    more: Float[np.ndarray, "k n 4 s"] | None = None


def equations_of(told: Told, given: Gathered, poses: Poses) -> Equations:
    """Residuals with their slopes."""
    count, turn, middle = len(poses.turn), poses.turn[:, None], given.middle
    outward = (turn @ told.normal[..., None])[..., 0].reshape(-1, 3)
    # Along an edge the normal does not turn, so only large principal curvatures count less.
    principal, axes = np.linalg.eigh(0.5 * (told.curvature + np.swapaxes(told.curvature, 2, 3)))
    size = np.abs(principal) * deviations(given.covariance)[:, None]
    share = (axes * np.minimum(1, _SHARP / np.maximum(size, 1e-300))[..., None, :]) @ np.swapaxes(
        axes, 2, 3
    )
    limited = share @ told.curvature
    curvature = (turn @ limited @ np.swapaxes(turn, 2, 3)).reshape(-1, 3, 3)
    point, normal = np.tile(given.point, (count, 1)), np.tile(given.normal, (count, 1))
    covariance = np.tile(given.covariance, (count, 1, 1))
    front = given.above + lifted(covariance, curvature)
    residual = np.column_stack([front - told.distance.ravel(), normal - outward])
    # Turned by ω about the middle and moved by v, the object passes a contact by ω × a + v, with a
    # from the middle to the contact; ω × a = −[a] ω.
    arm = crossed(point - middle)
    shift = np.broadcast_to(given.extent * np.eye(3), arm.shape)
    motion = np.concatenate([-arm, shift], axis=2)
    slope = np.zeros((len(point), 4, 6))
    slope[:, 0] = np.einsum("ni,nij->nj", outward, motion)
    slope[:, 1:] = curvature @ motion
    slope[:, 1:, :3] += crossed(outward)
    if told.more is not None:
        more = told.more.copy()
        more[:, :, 1:] = turn @ share @ more[:, :, 1:]
        slope = np.concatenate([slope, -more.reshape(len(point), 4, -1)], axis=2)
    root = np.linalg.cholesky(Noise.errors(normal, covariance, curvature, given.extent))
    both = np.linalg.solve(root, np.concatenate([residual[:, :, None], slope], axis=2))
    return Equations(
        both[:, :, 0].reshape(count, -1),
        both[:, :, 1:].reshape(count, 4 * len(given.point), -1),
        curvature.reshape(count, -1, 3, 3),
    )


_SHARP = 0.5
"""Turn of the normal over one deviation of the point beyond which it is not taken to grow, as at an
edge: there no direction is far from any other.
"""


@runtime_checkable
class Movable(Protocol):
    """Poses, alone or with other unknowns, that steps change."""

    def __iter__(self) -> Iterator[np.ndarray]:
        """Arrays of all poses."""

    def moved(self, step: Float[np.ndarray, "k u"], middle: Float[np.ndarray, "3"]) -> Any:
        """Each changed by a step, turns about a point."""

    def part(self, rows: Any) -> Any:
        """Some of them."""


Moved = TypeVar("Moved", bound=Movable)


def improved(
    evaluate: Callable[[Moved], Equations],
    start: Moved,
    middle: Float[np.ndarray, "3"],
    extent: float,
    *,
    held: Float[np.ndarray, "k u"] | None = None,
    steps: int = _STEPS,
    robust: bool = False,
) -> tuple[Moved, Equations]:
    """Levenberg and Marquardt's method for many poses side by side, each damped until it gains; a
    direction of each may be held, shifts in the extent. If robust, the equations are those.
    """

    def told_by(poses: Moved) -> Equations:
        told = evaluate(poses)
        return told.robust if robust else told

    found = told_by(start)
    count, _, unknowns = found.slope.shape
    units = np.ones(unknowns)
    units[3:6] = extent
    poses, damping, going = start.part(np.arange(count)), np.full(count, _DAMPING), np.arange(count)
    for _ in range(steps):
        here, before = found.part(going), poses.part(going)
        slope = here.slope
        if held is not None:
            along = slope @ held[going][..., None]
            slope = slope - along * held[going][:, None]
        normal = np.swapaxes(slope, 1, 2) @ slope
        size = np.einsum("kii->ki", normal)
        ridge = damping[going, None] * (size + _RIDGE * size.sum(axis=1, keepdims=True))
        pull = -np.einsum("kri,kr->ki", slope, here.residual)
        # Where nothing at all is known, as far from the object, nothing moves.
        whole = normal + (ridge + 1e-300)[:, :, None] * np.eye(unknowns)
        step = np.linalg.solve(whole, pull[..., None])[..., 0] * units
        trial = before.moved(step, middle)
        told = told_by(trial)
        gained = here.misfit - told.misfit
        better = gained > 0
        for values, others in zip((*poses, *found), (*trial, *told), strict=True):
            values[going[better]] = others[better]
        damping[going] = np.maximum(np.where(better, damping[going] / 5, 10 * damping[going]), 1e-9)
        settled = np.abs(gained) < _SETTLED * (1 + here.misfit)
        going = going[~settled & (damping[going] < _STUCK)]
        if not len(going):
            break
    return poses, found


def fitted(
    surface: Surface,
    given: Gathered,
    start: Poses,
    *,
    held: Float[np.ndarray, "k 6"] | None = None,
    steps: int = _STEPS,
    robust: bool = False,
) -> tuple[Poses, Equations]:
    """Poses at the nearest minima of the misfit."""
    return improved(
        partial(equations, surface, given),
        start,
        given.middle,
        given.extent,
        held=held,
        steps=steps,
        robust=robust,
    )


def errors(given: Gathered, curvature: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 4 4"]:
    """Covariance of each contact's residuals."""
    return Noise.errors(given.normal, given.covariance, curvature, given.extent)


class Likeness(NamedTuple):
    """What errors that are alike along a sweep change for one pose."""

    information: Float[np.ndarray, "u u"]
    """About motions, so that its inverse is the covariance of a fit that takes errors as
    independent.
    """
    factor: float
    """Variance of motions, relative to that of independent errors: a mean over directions."""
    share: float
    """Degrees of freedom of the misfit, relative to those of independent errors: its spread is that
    of so many.
    """


def likeness(given: Gathered, found: Equations) -> Likeness:
    """Of the first pose: the reach over which errors are alike is the most likely one given the
    residuals, up to their scale and what the fit has absorbed (restricted maximum likelihood).
    """
    sites, curvature, slope = single(given), found.curvature[0], found.slope[0]
    inverse = np.linalg.inv(np.linalg.cholesky(errors(given, curvature)))
    noise = Noise.of(sites, curvature, np.ones(len(slope) // 4), 1.0, given.extent, doubt=0.0)
    plain = slope.T @ slope
    ridge = _RIDGE * np.trace(plain) * np.eye(len(plain))
    told = 3 * len(inverse) - len(plain)
    spacing = [np.median(np.diff(noise.order[rows])) for rows in noise.groups if len(rows) > 1]
    if not spacing or told <= 0:
        return Likeness(plain, 1.0, 1.0)
    least = _unlikely(found.residual[0], slope, [np.eye(len(slope))], noise.groups[:0], told, ridge)
    best, limit = None, least - _SURE
    for reach in np.median(spacing) * _REACHES:
        parts = _alike(noise._replace(reach=float(reach)), inverse)
        unlikely = _unlikely(found.residual[0], slope, parts, noise.groups, told, ridge)
        if unlikely < limit:
            best, limit = parts, unlikely
    if best is None:
        return Likeness(plain, 1.0, 1.0)
    middle, total, square = np.zeros_like(plain), 0.0, 0.0
    for rows, whole in zip(noise.groups, best, strict=True):
        own = slope[columns_of(rows)]
        middle += own.T @ whole @ own
        total, square = total + np.trace(whole), square + np.sum(whole**2)
    factor = float(np.trace(np.linalg.solve(plain + ridge, middle)) / len(plain))
    information = plain @ np.linalg.solve(middle + ridge, plain)
    return Likeness(information, max(factor, 1.0), float(total / square))


_REACHES = np.geomspace(0.5, 20.0, 12)
"""Reaches that are compared, in the spacing of contacts."""
_SURE = 6.0
"""Twice the gain of the log-likelihood from which errors count as alike: independent ones gain
more in one case of a hundred.
"""


def _alike(noise: Noise, inverse: Float[np.ndarray, "n 4 4"]) -> list[np.ndarray]:
    """Covariance of the residuals of each sweep, in the contacts' own errors."""
    found = []
    for rows in noise.groups:
        whole = noise.among(rows).reshape(len(rows), 4, len(rows), 4)
        whole = np.einsum("iab,ibjc,jdc->iajd", inverse[rows], whole, inverse[rows], optimize=True)
        found.append(whole.reshape(4 * len(rows), -1))
    return found


def _unlikely(
    residual: Float[np.ndarray, "rows"],
    slope: Float[np.ndarray, "rows u"],
    parts: list[np.ndarray],
    groups: list[np.ndarray],
    told: int,
    ridge: Float[np.ndarray, "u u"],
) -> float:
    """Minus twice the logarithm of the restricted likelihood of residuals of unknown scale."""
    both = np.column_stack([slope, residual])
    normal, size = np.zeros((both.shape[1],) * 2), 0.0
    columns = [columns_of(rows) for rows in groups] or [np.arange(len(both))]
    for rows, whole in zip(columns, parts, strict=True):
        root = np.linalg.cholesky(whole)
        white = np.linalg.solve(root, both[rows])
        normal += white.T @ white
        size += 2 * np.log(np.diag(root)).sum()
    information, pull = normal[:-1, :-1] + ridge, normal[:-1, -1]
    square = normal[-1, -1] - pull @ np.linalg.solve(information, pull)
    return float(size + np.linalg.slogdet(information)[1] + told * np.log(square))


def crossed(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Matrices [a] with [a] b = a × b."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), -1, 0)


def _left(angle: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3 3"]:
    """From the shift of a screw to that of its exponential."""
    size = np.linalg.norm(angle, axis=1)[:, None, None]
    small = size < 1e-4  # where the series below are exact to rounding
    safe = np.where(small, 1.0, size)
    first = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6, (safe - np.sin(safe)) / safe**3)
    turning = crossed(angle)
    return np.eye(3) + first * turning + second * turning @ turning
