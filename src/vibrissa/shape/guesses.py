"""First guesses of a primitive's pose and sizes, from contacts with normals alone.

Linear least squares for each of many directions of the axis: all contacts obey, for the right one,
equations that are linear in the other unknowns.
"""

from collections.abc import Callable, Iterator

import numpy as np

from vibrissa.shape.kinds import Shaped
from vibrissa.shape.sites import Gathered
from vibrissa.surfaces import Box, Cone, Cylinder, Ellipsoid, Plane, Sphere, Surface, Torus

_DIRECTIONS = 40
"""Directions of an axis that guesses are made for: 25° apart."""


def guesses(kind: type[Surface], given: Gathered) -> Shaped:
    """First guesses, each a pose with sizes.

    Raises
    ------
    ValueError
        If the normals are all the same, and say nothing of a radius.
    """
    rng, count = np.random.default_rng(0), len(given.point)
    found = list(_GUESSES[kind](given.point, given.normal, given.extent))
    for _ in range(_PARTS if count >= 2 * _LEAST else 0):
        rows = rng.permutation(count)[: max(_LEAST, count // 2)]
        found += _GUESSES[kind](given.point[rows], given.normal[rows], given.extent)
    found = [each for each in found if all(np.all(np.isfinite(part)) for part in each)]
    if not found:
        raise ValueError("contacts: their normals are all the same; allowed are some that differ")
    turn, shift, sizes = (np.stack(part) for part in zip(*found, strict=True))
    least = 1e-3 * given.extent
    return Shaped(turn, shift, np.log(np.clip(sizes, least, 1e3 * given.extent)))


_PARTS, _LEAST = 6, 9
"""Halves of the contacts that guesses are made from too, as some are without outliers, and contacts
that such a half has at least.
"""


Guess = tuple[np.ndarray, np.ndarray, np.ndarray]


def _frame(axis: np.ndarray) -> np.ndarray:
    """Rotation matrix whose last column is an axis."""
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(axis, across), axis])


def _directions(normal: np.ndarray) -> Iterator[np.ndarray]:
    """Axes evenly over the sphere (Fibonacci), and principal ones of the normals."""
    number = np.arange(_DIRECTIONS) + 0.5
    z, angle = 1 - 2 * number / _DIRECTIONS, np.pi * (1 + 5**0.5) * number
    across = np.sqrt(1 - z**2)
    yield from np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
    for axes in (np.linalg.eigh(normal.T @ normal)[1].T, np.linalg.eigh(np.cov(normal.T))[1].T):
        yield from axes
        yield from -axes


def _plane(point: np.ndarray, normal: np.ndarray, _: float) -> Iterator[Guess]:
    axis = normal.mean(axis=0)
    yield _frame(axis / np.linalg.norm(axis)), point.mean(axis=0), np.zeros(0)


def _sphere(point: np.ndarray, normal: np.ndarray, _: float) -> Iterator[Guess]:
    """Points are c + r n; also some balls that a few wrong normals do not spoil."""
    unit, place = normal - normal.mean(axis=0), point - point.mean(axis=0)
    spread = float(np.sum(unit**2))
    if spread < _PARALLEL:
        return
    radius = abs(float(np.sum(unit * place)) / spread)
    for factor in (1.0, 0.5, 2.0):
        center = np.median(point - factor * radius * normal, axis=0)
        yield np.eye(3), center, np.array([factor * radius])


_PARALLEL = 1e-24
"""Sum of squared differences of normals that is due to rounding."""


def _cylinder(point: np.ndarray, normal: np.ndarray, extent: float) -> Iterator[Guess]:
    for axis in _directions(normal):
        turn = _frame(axis)
        place, unit = point @ turn, normal @ turn
        side = np.abs(unit[:, 2]) < _STEEP
        if side.sum() < 3:
            continue
        one, other = place[side, :2], unit[side, :2]
        apart = other - other.mean(axis=0)
        radius = abs(np.sum(apart * (one - one.mean(axis=0))) / np.maximum(np.sum(apart**2), 1e-9))
        center = np.median(one - radius * other, axis=0)
        low, high = place[:, 2].min(), place[:, 2].max()
        # Ends where contacts say so; else beyond all of them.
        low = low if np.any(unit[:, 2] < -_STEEP) else low - extent
        high = high if np.any(unit[:, 2] > _STEEP) else high + extent
        shift = turn @ [*center, 0.5 * (low + high)]
        yield turn, shift, np.array([min(radius, 10 * extent), high - low])


_STEEP = 0.7
"""Component of a normal along the axis from which it is taken for that of an end."""


def _cone(point: np.ndarray, normal: np.ndarray, extent: float) -> Iterator[Guess]:
    """On the side n·a = sin α, and the apex q lies in all tangent planes: n·(p − q) = 0."""
    for axis in _directions(normal):
        along = normal @ axis
        side = along > -_STEEP
        if side.sum() < 3:
            continue
        angle = np.arcsin(np.clip(np.median(along[side]), 0.02, 0.98))
        right = np.einsum("ni,ni->n", normal[side], point[side])
        apex = np.linalg.lstsq(normal[side], right, rcond=None)[0]
        below = (apex - point) @ axis
        height = below.max() if not np.all(side) else below.max() + extent
        yield _frame(axis), apex, np.array([angle, max(height, 0.1 * extent)])


def _torus(point: np.ndarray, normal: np.ndarray, extent: float) -> Iterator[Guess]:
    """Along the axis p = c + r n; with r, the points p − r n lie on a circle about it."""
    for axis in _directions(normal):
        turn = _frame(axis)
        place, unit = point @ turn, normal @ turn
        line = np.column_stack([np.ones(len(place)), unit[:, 2]])
        level, tube = np.linalg.lstsq(line, place[:, 2], rcond=None)[0]
        tube = abs(tube)
        ring = (place - tube * unit)[:, :2]
        circle = np.column_stack([2 * ring, np.ones(len(ring))])
        found = np.linalg.lstsq(circle, np.sum(ring**2, axis=1), rcond=None)[0]
        radius = np.sqrt(max(found[2] + found[0] ** 2 + found[1] ** 2, 0.0))
        radius = min(radius, 10 * extent)
        yield turn, turn @ [*found[:2], level], np.array([radius, min(tube, 0.95 * radius)])


def _ellipsoid(point: np.ndarray, normal: np.ndarray, extent: float) -> Iterator[Guess]:
    """The quadric p·Ap + 2 b·p = c whose gradients Ap + b are along the normals; and ellipsoids of
    different axes about the middle.
    """
    middle = point.mean(axis=0)
    place = (point - middle) / extent
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    rows = np.zeros((len(place), 4, 10))
    for column, (i, j) in enumerate(pairs):
        twice = 1.0 if i == j else 2.0
        rows[:, 0, column] = twice * place[:, i] * place[:, j]
        rows[:, 1 + i, column] += place[:, j]
        if i != j:
            rows[:, 1 + j, column] += place[:, i]
    rows[:, 0, 6:9], rows[:, 0, 9], rows[:, 1:, 6:9] = 2 * place, -1.0, np.eye(3)
    across = np.eye(3) - normal[:, :, None] * normal[:, None]
    rows[:, 1:] = across @ rows[:, 1:]
    found = np.linalg.svd(rows.reshape(-1, 10))[2][-1]
    matrix = np.zeros((3, 3))
    for column, (i, j) in enumerate(pairs):
        matrix[i, j] = matrix[j, i] = found[column]
    values, axes = np.linalg.eigh(matrix)
    if np.all(values * values[0] > 0):
        center = -np.linalg.solve(matrix, found[6:9])
        squares = (found[9] + center @ matrix @ center) / values
        if np.all(squares > 0):
            yield _right(axes), middle + extent * center, extent * np.sqrt(squares)
    for turn in (
        np.linalg.eigh(np.cov(point.T))[1],
        np.linalg.eigh(np.cov(normal.T))[1],
        np.eye(3),
    ):
        half = 0.5 * np.ptp(point @ turn, axis=0)
        for factor in (1.0, 1.5):
            yield _right(turn), middle, factor * np.maximum(half, 0.1 * extent)


def _box(point: np.ndarray, normal: np.ndarray, extent: float) -> Iterator[Guess]:
    """Axes from two normals that are almost perpendicular; faces where contacts have them."""
    first, second = np.nonzero(np.abs(normal @ normal.T) < _SQUARE)
    # Of a single face, those within it are open.
    turns = [_frame(normal[0])] if not len(first) else []
    for i, j in zip(first[first < second], second[first < second], strict=True):
        other = normal[j] - (normal[j] @ normal[i]) * normal[i]
        other /= np.linalg.norm(other)
        turns.append(np.column_stack([normal[i], other, np.cross(normal[i], other)]))
    for turn in turns:
        place, unit = point @ turn, normal @ turn
        low, high = place.min(axis=0), place.max(axis=0)
        for axis in range(3):
            faces = place[unit[:, axis] > 0.9, axis], place[unit[:, axis] < -0.9, axis]
            high[axis] = np.median(faces[0]) if len(faces[0]) else high[axis] + 0.5 * extent
            low[axis] = np.median(faces[1]) if len(faces[1]) else low[axis] - 0.5 * extent
        yield turn, turn @ (0.5 * (low + high)), 0.5 * np.abs(high - low)


_SQUARE = 0.2
"""Cosine between normals of two faces, with errors, below which they are perpendicular."""


def _right(axes: np.ndarray) -> np.ndarray:
    """Right-handed."""
    return axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])


_GUESSES: dict[type[Surface], Callable[[np.ndarray, np.ndarray, float], Iterator[Guess]]] = {
    Plane: _plane,
    Sphere: _sphere,
    Cylinder: _cylinder,
    Cone: _cone,
    Torus: _torus,
    Ellipsoid: _ellipsoid,
    Box: _box,
}
