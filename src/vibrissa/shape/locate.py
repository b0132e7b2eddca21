"""Where a known object is: its pose from a few contacts.

A contact at p with normal n belongs to an object with signed distance d, turned by R and moved by
t, if d(q) = 0 and ∇d(q) = Rᵀn at q = Rᵀ(p − t): the equations of a surface fit (`noise`), with the
pose as unknown in place of the surface.

From a cold start, pairs of contacts are compared with pairs of points of the object: those with the
same distance and the same angles between normals and chord give a pose (point pair features: Drost
et al., CVPR 2010). The best of them, by all contacts, start Gauss and Newton's method.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from vibrissa.contacts import Contacts
from vibrissa.shape.area import points_over
from vibrissa.shape.noise import Noise
from vibrissa.shape.sites import Gathered, gathered, spread_out
from vibrissa.surfaces import Placed, Surface

_SAMPLES = 700
"""Points of the object that pairs are taken from."""
_PAIRS, _MATCHES = 12, 4000
"""Pairs of contacts, the widest first, and pairs of the object that each is compared with."""
_STARTS = 60
"""Poses that are improved."""
_STEPS, _SETTLED = 30, 1e-8
"""Most steps, and the relative gain of the misfit below which all poses have settled."""
_DAMPING, _RIDGE = 1e-3, 1e-9
"""First damping, relative to each unknown's information, and to that of all for what is free."""
_LIKELY = 12.0
"""Squared residual above that of the best pose, in stated errors, up to which a pose fits too."""
_FREE = 1e-6
"""Information along a direction, relative to the largest, below which nothing determines it:
lengths in the extent of the contacts.
"""
_SAME = 1e-2
"""Difference of poses, as an angle or relative to the extent, that is none."""
_WORSE = 1e-6
"""Probability of a misfit as large as the best pose's, below which a word is due."""


class Pose(NamedTuple):
    """Where an object is: its points x lie at `rotation` x + `translation`."""

    rotation: Rotation
    translation: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "6 6"]
    """Of a small rotation vector about the contacts' middle [rad] and a shift there, world axes;
    nothing along directions that are free.
    """
    free: Float[np.ndarray, "k 6"]
    """Directions of such a motion that the contacts leave open, as of a symmetric object."""
    misfit: float
    """Sum of squared residuals in stated errors."""


@dataclass(frozen=True, eq=False)
class Location:
    """Poses of a known object that contacts allow, the best first.

    Attributes
    ----------
    surface
        The object as it was given.
    poses
        All poses found that fit; those that differ by a free motion only are one.
    middle
        (3,) middle of the contacts, about which covariances are.
    freedom
        Degrees of freedom of the misfit.
    warnings
        One line if even the best pose does not fit.
    """

    surface: Surface
    poses: list[Pose]
    middle: Float[np.ndarray, "3"]
    freedom: int
    warnings: list[str]

    def __repr__(self) -> str:
        """Return one line for each pose."""
        lines = [f"Location with {len(self.poses)} poses, {self.freedom} degrees of freedom"]
        for pose in self.poses:
            turn = np.degrees(pose.rotation.magnitude())
            lines.append(
                f"  misfit {pose.misfit:.3g}, {len(pose.free)} directions free, turned by "
                f"{turn:.1f}°, moved by {np.array2string(pose.translation, precision=4)}"
            )
        return "\n".join(lines)

    @property
    def rotation(self) -> Rotation:
        """Of the best pose."""
        return self.poses[0].rotation

    @property
    def translation(self) -> Float[np.ndarray, "3"]:
        """Of the best pose."""
        return self.poses[0].translation

    @property
    def covariance(self) -> Float[np.ndarray, "6 6"]:
        """Of the best pose."""
        return self.poses[0].covariance

    @property
    def placed(self) -> Placed:
        """The object at the best pose."""
        return self.surface.placed(self.rotation, self.translation)


def locate(surface: Surface, contacts: Contacts | Sequence[Contacts]) -> Location:
    """Pose of a known object from a few contacts with normals, without a first guess.

    Parameters
    ----------
    surface
        The object in its own axes, about their origin: a mesh or any other surface.
    contacts
        With covariances, best `vibrissa.smooth(found).contacts`; those of a sweep are taken as
        independent, so that a few spread over the object say as much as all.

    Returns
    -------
    Location
        All poses that fit: several where the object is symmetric or the contacts leave more than
        one; directions that they leave free are named.

    Raises
    ------
    ValueError
        If fewer than three contacts can be used, or nothing is found of the object about its
        origin.
    ImportError
        If the libraries of `vibrissa[mesh]` are not installed.

    Notes
    -----
    Covariances are linear: they understate what is left open where no contact is on the part that
    tells poses apart, such as a mug's handle (mechanics.md, "Where a known object is").
    """
    given = gathered(contacts)
    sampled = _samples(surface, given.extent, np.random.default_rng(0))
    found = _improved(surface, given, _starts(given, sampled))
    best = min(each.misfit for each in found)
    likely = sorted((f for f in found if f.misfit < best + _LIKELY), key=lambda f: f.misfit)
    middle = given.point.mean(axis=0)
    poses: list[Pose] = []
    for pose in likely:
        if not any(_same(pose, other, middle, given.extent) for other in poses):
            poses.append(pose)
    freedom = 3 * len(given.point) - 6 + len(poses[0].free)
    warnings = []
    if freedom > 0 and chi2.sf(best, freedom) < _WORSE:
        warnings.append(
            f"the best pose misses the contacts by {np.sqrt(best / freedom):.2g} times their "
            "stated errors: it may be another object, or deformed"
        )
    return Location(surface, poses, middle, freedom, warnings)


class _Poses(NamedTuple):
    """Rotation matrices and shifts of some poses."""

    turn: Float[np.ndarray, "k 3 3"]
    shift: Float[np.ndarray, "k 3"]

    def moved(self, step: Float[np.ndarray, "k 6"], middle: Float[np.ndarray, "3"]) -> "_Poses":
        """Each turned about a point, then shifted."""
        turn = Rotation.from_rotvec(step[:, :3]).as_matrix()
        shift = (turn @ (self.shift - middle)[..., None])[..., 0] + middle + step[:, 3:]
        return _Poses(turn @ self.turn, shift)

    def chosen(self, rows: Bool[np.ndarray, "k"], other: "_Poses") -> "_Poses":
        """The other's poses in some rows."""
        turn = np.where(rows[:, None, None], other.turn, self.turn)
        return _Poses(turn, np.where(rows[:, None], other.shift, self.shift))


class _Sampled(NamedTuple):
    """Points of the object, and its outward normals there."""

    point: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]


def _samples(surface: Surface, extent: float, rng: np.random.Generator) -> _Sampled:
    """Points spread evenly over the object."""
    origin = np.zeros((1, 3))
    nothing = "surface: nothing of it is near its origin"
    reach, beyond, count = 20 * extent, 2 * extent, 8 * _SAMPLES
    points = points_over(surface, origin, reach, beyond, count, rng, said=nothing)
    points = points[spread_out(points, _SAMPLES)]
    return _Sampled(points, surface.normal(points))


def _starts(given: Gathered, sampled: _Sampled) -> _Poses:
    """Poses that bring pairs of contacts onto pairs of the object, the best by all contacts."""
    first, second = np.nonzero(~np.eye(len(sampled.point), dtype=bool))
    features = _features(sampled.point, sampled.normal, first, second, given.extent)
    tree = KDTree(features)
    rotations, translations = [], []
    for i, j in _pairs(given):
        ends = np.array([i]), np.array([j])
        own = _features(given.point, given.normal, *ends, given.extent)[0]
        _, near = tree.query(own, min(_MATCHES, len(features)))
        there = _frames(sampled.point, sampled.normal, first[near], second[near])
        here = _frames(given.point, given.normal, *ends)
        turn = here @ np.swapaxes(there, 1, 2)
        middle = 0.5 * (sampled.point[first[near]] + sampled.point[second[near]])
        rotations.append(turn)
        translations.append(
            0.5 * (given.point[i] + given.point[j]) - np.einsum("nij,nj->ni", turn, middle)
        )
    turn, shift = np.concatenate(rotations), np.concatenate(translations)
    score = _scores(given, sampled, turn, shift)
    chosen: list[int] = []
    for row in np.argsort(score):
        apart = [
            Rotation.from_matrix(turn[row] @ turn[other].T).magnitude()
            + np.linalg.norm(shift[row] - shift[other]) / given.extent
            for other in chosen
        ]
        if not apart or min(apart) > _APART:
            chosen.append(int(row))
        if len(chosen) == _STARTS:
            break
    return _Poses(turn[chosen], shift[chosen])


_APART = 0.15
"""Difference of two starts, as angle plus relative shift: Newton's method bridges less."""


def _pairs(given: Gathered) -> list[tuple[int, int]]:
    """Pairs of contacts with the widest chords and normals that differ most."""
    first, second = np.triu_indices(len(given.point), 1)
    chord = np.linalg.norm(given.point[first] - given.point[second], axis=1) / given.extent
    across = np.linalg.norm(np.cross(given.normal[first], given.normal[second]), axis=1)
    best = np.argsort(-(chord * (0.2 + across)))[:_PAIRS]
    return list(zip(first[best].tolist(), second[best].tolist(), strict=True))


def _features(
    point: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    first: Int[np.ndarray, "k"],
    second: Int[np.ndarray, "k"],
    extent: float,
) -> Float[np.ndarray, "k 4"]:
    """Length of the chord, relative to the extent, and cosines that do not change with the pose."""
    chord = point[second] - point[first]
    length = np.linalg.norm(chord, axis=1)
    along = chord / length[:, None]
    one, other = normal[first], normal[second]
    cosines = [
        np.einsum("ni,ni->n", *pair) for pair in ((one, along), (other, along), (one, other))
    ]
    return np.column_stack([2 * length / extent, *cosines])


def _frames(
    point: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    first: Int[np.ndarray, "k"],
    second: Int[np.ndarray, "k"],
) -> Float[np.ndarray, "k 3 3"]:
    """Axes of pairs: along the chord, and towards the sum or difference of the normals."""
    along = point[second] - point[first]
    along /= np.linalg.norm(along, axis=1)[:, None]
    total = normal[first] + normal[second]
    # Opposite normals have no sum.
    total = np.where(
        np.linalg.norm(total, axis=1)[:, None] > 0.3, total, normal[first] - normal[second]
    )
    aside = total - np.einsum("ni,ni->n", total, along)[:, None] * along
    aside /= np.maximum(np.linalg.norm(aside, axis=1), 1e-12)[:, None]
    return np.stack([along, aside, np.cross(along, aside)], axis=-1)


def _scores(
    given: Gathered,
    sampled: _Sampled,
    turn: Float[np.ndarray, "k 3 3"],
    shift: Float[np.ndarray, "k 3"],
) -> Float[np.ndarray, "k"]:
    """How far poses miss the contacts: robust mean over contacts of distance and normal."""
    score = np.zeros(len(turn))
    tree = KDTree(sampled.point)
    for point, normal in zip(given.point, given.normal, strict=True):
        place = np.einsum("nji,nj->ni", turn, point - shift)
        direction = np.einsum("nji,j->ni", turn, normal)
        _, near = tree.query(place)
        apart, there = place - sampled.point[near], sampled.normal[near]
        off = np.einsum("ni,ni->n", apart, there) / given.extent
        far = np.linalg.norm(apart, axis=1) / given.extent
        tilt = np.linalg.norm(direction - there, axis=1)
        score += np.minimum((off / 0.02) ** 2 + (far / 0.1) ** 2 + (tilt / 0.3) ** 2, 9.0)
    return score


def _improved(surface: Surface, given: Gathered, start: _Poses) -> list[Pose]:
    """Levenberg and Marquardt's method for many poses side by side, each damped until it gains."""
    middle, units = given.point.mean(axis=0), np.repeat([1.0, given.extent], 3)
    poses, count = start, len(start.turn)
    residual, slope = _equations(surface, given, poses, middle)
    misfit, damping = np.einsum("kr,kr->k", residual, residual), np.full(count, _DAMPING)
    for _ in range(_STEPS):
        scaled = slope * units
        normal = np.swapaxes(scaled, 1, 2) @ scaled
        size = np.einsum("kii->ki", normal)
        ridge = damping[:, None] * (size + _RIDGE * size.sum(axis=1, keepdims=True))
        pull = -np.einsum("kri,kr->ki", scaled, residual)
        whole = normal + ridge[:, :, None] * np.eye(6)
        step = np.linalg.solve(whole, pull[..., None])[..., 0] * units
        trial = poses.moved(step, middle)
        told, bent = _equations(surface, given, trial, middle)
        gained = misfit - np.einsum("kr,kr->k", told, told)
        better = gained > 0
        poses = poses.chosen(better, trial)
        residual = np.where(better[:, None], told, residual)
        slope = np.where(better[:, None, None], bent, slope)
        misfit = np.where(better, misfit - gained, misfit)
        damping = np.clip(np.where(better, damping / 5, 10 * damping), 1e-12, 1e6)
        if np.all(np.abs(gained) < _SETTLED * (1 + misfit)):
            break
    return [
        _pose(Rotation.from_matrix(poses.turn[k]), poses.shift[k], slope[k] * units, units, each)
        for k, each in enumerate(misfit.tolist())
    ]


def _pose(
    rotation: Rotation,
    translation: Float[np.ndarray, "3"],
    slope: Float[np.ndarray, "rows 6"],
    units: Float[np.ndarray, "6"],
    misfit: float,
) -> Pose:
    """With the covariance that the slopes give, and what they leave open."""
    values, axes = np.linalg.eigh(slope.T @ slope)
    known = values > _FREE * values[-1]
    spread = (axes[:, known] / values[known]) @ axes[:, known].T
    free = axes[:, ~known].T * units
    return Pose(rotation, translation, spread * units * units[:, None], free, misfit)


def _equations(
    surface: Surface, given: Gathered, poses: _Poses, middle: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "k rows"], Float[np.ndarray, "k rows 6"]]:
    """Residuals of all contacts in their errors for each pose, and slopes by a rotation about the
    middle and a shift, world axes.
    """
    count, turn = len(poses.turn), poses.turn[:, None]
    own = ((given.point - poses.shift[:, None])[:, :, None] @ turn)[:, :, 0]
    step = 1e-4 * given.extent
    moved = [own + sign * step * axis for axis in np.eye(3) for sign in (1, -1)]
    normals = surface.normal(np.stack([own, *moved]))
    bent = np.stack([normals[i] - normals[i + 1] for i in (1, 3, 5)], axis=-1) / (2 * step)
    outward = (turn @ normals[0][..., None])[..., 0].reshape(-1, 3)
    curvature = (turn @ bent @ np.swapaxes(turn, 2, 3)).reshape(-1, 3, 3)
    point, normal = np.tile(given.point, (count, 1)), np.tile(given.normal, (count, 1))
    covariance = np.tile(given.covariance, (count, 1, 1))
    residual = np.column_stack([-surface.distances(own).ravel(), normal - outward])
    # Turned by ω about the middle and moved by v, the object passes a contact by ω × a + v, with a
    # from the middle to the contact; ω × a = −[a] ω.
    arm = _crossed(point - middle)
    motion = np.concatenate([-arm, np.broadcast_to(np.eye(3), arm.shape)], axis=2)
    slope = np.zeros((len(point), 4, 6))
    slope[:, 0] = np.einsum("ni,nij->nj", outward, motion)
    slope[:, 1:] = curvature @ motion
    slope[:, 1:, :3] += _crossed(outward)
    root = np.linalg.cholesky(Noise.errors(normal, covariance, curvature, given.extent))
    both = np.linalg.solve(root, np.concatenate([residual[:, :, None], slope], axis=2))
    return both[:, :, 0].reshape(count, -1), both[:, :, 1:].reshape(count, -1, 6)


def _crossed(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Matrices [a] with [a] b = a × b."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), -1, 0)


def _same(one: Pose, other: Pose, middle: Float[np.ndarray, "3"], extent: float) -> bool:
    """Whether two poses differ by no more than a motion that is free.

    The motion between them, about the contacts' middle, is exp of a rotation vector and a shift;
    those of a symmetry are free.
    """
    turn = (one.rotation * other.rotation.inv()).as_rotvec()
    shift = (
        one.rotation.apply(other.rotation.inv().apply(middle - other.translation))
        + one.translation
        - middle
    )
    angle = np.linalg.norm(turn)
    if angle > _SAME:
        # The shift of a screw, per angle: that of the exponential.
        axis = turn / angle
        crossed = _crossed(axis[None])[0]
        left = (
            np.eye(3)
            - 0.5 * angle * crossed
            + (1 - 0.5 * angle / np.tan(0.5 * angle)) * crossed @ crossed
        )
        shift = left @ shift
    units = np.repeat([1.0, extent], 3)
    motion = np.concatenate([turn, shift]) / units
    if len(other.free):
        axes = np.linalg.qr((other.free / units).T)[0]
        motion = motion - axes @ (axes.T @ motion)
    return bool(np.linalg.norm(motion) < _SAME)
