"""Contacts of one or many sweeps as a surface fit uses them: sound rows only, neighbours of a sweep
pooled, with the joint covariance of point and normal.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind, Contacts, Status

LEAST = 3
"""Contacts without which there is no surface."""
_MOST = 1500
"""Pooled contacts, beyond which neighbours of a sweep are pooled over longer distances."""
_LARGEST = 200_000
"""Contacts, beyond which every second, third ... is used: more take longer and tell nothing new, as
they are pooled.
"""
_FINEST = 1 / 80
"""Shortest distance over which contacts are pooled, relative to the extent of all: a millimetre on
a ball of 50 mm, half of what errors of smoothed contacts are alike over.
"""
_ALIKE = 2.0
"""What errors of smoothed contacts are alike over, in that distance."""
_WIDEST = 1 / 30
"""Distance beyond which contacts of one sweep are not pooled, but those of several are."""
_LOST = 1.0
"""Error of a normal [rad] from which on a contact says nothing: errors are taken as linear, and the
contacts of a rod that hardly touches, tens of millimetres off, would still pull as hard.
"""
_USUAL = {"covariance": 2e-3, "normal_covariance": 0.01}
"""Standard deviations assumed where none are given: of points, relative to the extent, and of
normals [rad]. For a surface only their order of magnitude counts, as its fit estimates a factor.
"""


class Sites(NamedTuple):
    """Pooled contacts (n): mean point and normal, their joint covariance, the sweep each belongs
    to, and its place in the order of that sweep.
    """

    point: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    covariance: Float[np.ndarray, "n 6 6"]
    sweep: Int[np.ndarray, "n"]
    order: Float[np.ndarray, "n"]
    size: Int[np.ndarray, "n"]
    """Contacts in each."""
    half: Int[np.ndarray, "n"]
    """0 or 1: every second sweep is in the other half."""
    alike: Float[np.ndarray, "n"]
    """Factor of variances that stands for what errors of neighbours have in common, where that is
    not told by their sweep. How far the means lie in front of the surface does not grow with it:
    with it, balls and ellipsoids were 3 to 5 µm too small, and are now known to 1 µm on average.
    """
    above: Float[np.ndarray, "n"]
    """Heights of the points over the object."""

    @property
    def touched(self) -> Float[np.ndarray, "n 3"]:
        """Where the object was touched."""
        return self.point - self.above[:, None] * self.normal

    def part(self, rows: Any) -> "Sites":
        """Some of them."""
        return Sites(*(values[rows] for values in self))


class Gathered(NamedTuple):
    """Rows that count as contacts, of all that were given."""

    rows: Bool[np.ndarray, "given"]
    point: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    covariance: Float[np.ndarray, "n 6 6"]
    sweep: Int[np.ndarray, "n"]
    order: Float[np.ndarray, "n"]
    """Number of each."""
    assumed: tuple[str, ...]
    """Names of covariances that were not given."""
    extent: float
    """Diagonal of the box around all points."""
    middle: Float[np.ndarray, "3"]
    """Mean of all points."""
    far: Bool[np.ndarray, "given"]
    """Rows that hold contacts, but too far from all others to be of the object."""
    step: int = 1
    """One in so many is used."""
    above: float = 0.0
    """How far the points lie in front of the surface."""

    @property
    def known(self) -> bool:
        """Whether the points' covariances were given, not assumed."""
        return "covariance" not in self.assumed

    def part(self, rows: Any) -> "Gathered":
        """Some of the contacts."""
        return self._replace(
            point=self.point[rows],
            normal=self.normal[rows],
            covariance=self.covariance[rows],
            sweep=self.sweep[rows],
            order=self.order[rows],
        )

    def raised(self, above: float) -> "Gathered":
        """Moved along their normals, to the surface at some distance: its edges are round, where
        normals turn at a sharp one from one face to the other in no distance.
        """
        moved = np.eye(6)
        moved[:3, 3:] = above * np.eye(3)
        return self._replace(
            point=self.point + above * self.normal,
            covariance=moved @ self.covariance @ moved.T,
            above=self.above + above,
        )

    def outliers(self, outlier: Bool[np.ndarray, "n"]) -> Bool[np.ndarray, "given"]:
        """Which of the rows given are, if these contacts are, and those too far away."""
        rows = self.far.copy()
        rows[self.rows] = outlier
        return rows


def assumptions(given: Gathered) -> list[str]:
    """A line for each covariance that was not given."""
    point, normal = _USUAL.values()
    of = f"points of {point * given.extent:.2g}", f"normals of {normal} rad"
    return [
        f"contacts: {name} is not given; errors of {each} are assumed, and intervals, misfit and "
        "outliers are as good as that"
        for name, each in zip(_USUAL, of, strict=True)
        if name in given.assumed
    ]


def deviations(covariance: Float[np.ndarray, "n 6 6"]) -> Float[np.ndarray, "n"]:
    """Standard deviations of points: mean over directions."""
    return np.sqrt(np.einsum("nii->n", covariance[:, :3, :3]) / 3)


def room(given: Gathered) -> float:
    """Radius of a ball outside that touches the object at a contact, and reaches others across a
    gap or a concave corner; for all but a few of the contacts it is larger.
    """
    part = given.part(slice(None, None, -(-len(given.point) // _SAMPLED)))
    apart = part.point - part.point[:, None]
    here = np.einsum("mni,mi->mn", apart, part.normal)
    there = -np.einsum("mni,ni->mn", apart, part.normal)
    facing = np.minimum(here, there) > _CLEAR * given.extent
    facing &= part.normal @ part.normal.T < _TURNED
    radius = np.full(here.shape, np.inf)
    radius[facing] = np.sum(apart[facing] ** 2, axis=1) / (2 * here[facing])
    return float(np.quantile(radius.min(axis=1), _TIGHT, method="lower"))


def thickness(
    point: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "n 3"], extent: float
) -> float:
    """Least distance of faces that look opposite ways, one behind the other; for all but a few of
    the contacts it is larger. Infinite if there are none.
    """
    every = slice(None, None, -(-len(point) // _SAMPLED))
    point, normal = point[every], normal[every]
    apart = point[:, None] - point
    behind = np.einsum("mni,mi->mn", apart, normal)
    opposite = np.minimum(behind, behind.T) > _CLEAR * extent
    opposite &= normal @ normal.T < _OPPOSITE
    opposite &= np.sum(apart**2, axis=2) - behind**2 < (_ASIDE * extent) ** 2
    return float(
        np.quantile(np.where(opposite, behind, np.inf).min(axis=1), _TIGHT, method="lower")
    )


_SAMPLED = 1000
"""Contacts that are compared, at most."""
_CLEAR = 0.005
"""Height of contacts that face one another over the other's tangent plane, relative to the extent:
far more than errors, and far less than the height at which contacts are used.
"""
_TURNED = 0.5
"""Cosine of the angle between their normals, at most: an outlier in front of a face is turned less.
"""
_OPPOSITE = -0.7
"""The same of faces of a plate; at an edge they are turned less."""
_ASIDE = 0.1
"""How far aside of being behind one another contacts may be, relative to the extent."""
_TIGHT = 0.01
"""Share of contacts with less room: some in a hundred may be outliers."""


def outside(given: Gathered) -> Gathered:
    """Raised by three deviations of their points: at an edge, a point slightly inside the object
    has the normal of either face.
    """
    return given.raised(_OUTSIDE * float(np.median(deviations(given.covariance))))


_OUTSIDE = 3.0
"""Deviations by which hardly any point is inside."""


def several(contacts: Contacts | Sequence[Contacts]) -> list[Contacts]:
    """Contacts of sweeps as a list of them.

    Raises
    ------
    ValueError
        If one of them is something else.
    """
    parts = [contacts] if isinstance(contacts, Contacts) else list(contacts)
    for number, part in enumerate(parts):
        if not isinstance(part, Contacts):
            raise ValueError(
                f"contacts[{number}] is a {type(part).__name__}; allowed are vibrissa.Contacts, "
                "such as `smooth(found).contacts`"
            )
    return parts


def gathered(contacts: Contacts | Sequence[Contacts]) -> Gathered:
    """Sound contacts in the order given, sweeps numbered through.

    Raises
    ------
    ValueError
        If there are too few, all lie in one place, or a covariance has a negative eigenvalue.
    """
    parts = several(contacts)
    sound = [_sound(part) for part in parts]
    far = _far(parts, sound)
    sound = [one & ~other for one, other in zip(sound, far, strict=True)]
    step = max(-(-sum(int(rows.sum()) for rows in sound) // _LARGEST), 1)
    columns = [_columns(part, use, step) for part, use in zip(parts, sound, strict=True)]
    rows = np.concatenate([column[0] for column in columns] or [np.zeros(0, dtype=bool)])
    if rows.sum() < LEAST:
        given = f"{rows.sum()} of {len(rows)} rows hold a contact with status OK and a known normal"
        raise ValueError(f"contacts: {given}; allowed are at least {LEAST}")
    point, normal = (np.concatenate([column[i] for column in columns]) for i in (1, 2))
    extent = float(np.linalg.norm(np.ptp(point, axis=0)))
    if extent == 0:
        raise ValueError("contacts: all lie in one place; allowed are contacts that are apart")
    joint = [_joint(part, column[0], extent) for part, column in zip(parts, columns, strict=True)]
    sweeps, first = [], 0
    for part, column in zip(parts, columns, strict=True):
        # Sweeps without a contact count too, so that a word about one names the right one.
        values = np.unique(_sweep_of(part))
        sweeps.append(np.searchsorted(values, column[3]) + first)
        first += max(len(values), 1)
    assumed = tuple(name for name in _USUAL if any(getattr(part, name) is None for part in parts))
    order = np.arange(len(point), dtype=float)
    sweep = np.concatenate(sweeps)
    covariance, middle = np.concatenate(joint), point.mean(axis=0)
    lost = np.concatenate(far)
    return Gathered(
        rows, point, normal, covariance, sweep, order, assumed, extent, middle, lost, step
    )


def _far(parts: list[Contacts], sound: list[Bool[np.ndarray, "_"]]) -> list[Bool[np.ndarray, "_"]]:
    """A few contacts that lie farther from all others than these are apart. They would set the
    scale of everything.
    """
    found = [np.zeros_like(rows) for rows in sound]
    used = [part.point.reshape(-1, 3)[rows] for part, rows in zip(parts, sound, strict=True)]
    point = np.concatenate([*used, np.zeros((0, 3))])
    most = int(_STRAY * len(point))
    if most:
        away = np.abs(point - np.median(point, axis=0)).max(axis=1)
        rest = point[np.argsort(away, kind="stable")[:-most]]
        low, high = rest.min(axis=0), rest.max(axis=0)
        outside = np.maximum(low - point, point - high).max(axis=1)
        far = outside > (high - low).max()
        ends = np.cumsum([len(points) for points in used])[:-1]
        for here, rows, flags in zip(found, sound, np.split(far, ends), strict=True):
            here[rows] = flags
    return found


_STRAY = 0.02
"""Share of contacts that may be left out as too far away: of fewer than fifty, none."""


def _sound(part: Contacts) -> Bool[np.ndarray, "n"]:
    """Rows that hold a contact."""
    point, normal = part.point.reshape(-1, 3), part.normal.reshape(-1, 3)
    use = np.isfinite(point).all(axis=1) & np.isfinite(normal).all(axis=1)
    if part.kind is not None:
        use &= part.kind.reshape(-1) != ContactKind.NONE
    if part.status is not None:
        use &= part.status.reshape(-1) == Status.OK
    for spread in (part.covariance, part.normal_covariance):
        if spread is not None:
            use &= np.isfinite(spread).all(axis=(-2, -1)).reshape(-1)
    if part.normal_covariance is not None:
        use &= np.einsum("nii->n", part.normal_covariance.reshape(-1, 3, 3)) < _LOST**2
    return use


def _columns(part: Contacts, sound: Bool[np.ndarray, "n"], step: int) -> tuple[np.ndarray, ...]:
    """Which rows count, one in so many of those that are sound, and their points, normals and
    sweeps.
    """
    use = np.zeros_like(sound)
    use[np.flatnonzero(sound)[::step]] = True
    point, normal = part.point.reshape(-1, 3), part.normal.reshape(-1, 3)
    return use, point[use], normal[use], _sweep_of(part)[use]


def _sweep_of(part: Contacts) -> Int[np.ndarray, "n"]:
    """The sweep of each row."""
    if part.sweep is None:
        return np.zeros(part.point.size // 3, dtype=np.int64)
    return part.sweep.reshape(-1)


def _joint(part: Contacts, use: np.ndarray, extent: float) -> Float[np.ndarray, "n 6 6"]:
    """Covariance of point and normal together, as far as it is given."""
    joint = np.zeros((int(use.sum()), 6, 6))
    units = (slice(3), extent), (slice(3, 6), 1.0)
    for (place, unit), (name, usual) in zip(units, _USUAL.items(), strict=True):
        spread = getattr(part, name)
        if spread is None:
            joint[:, place, place] = (usual * unit) ** 2 * np.eye(3)
        else:
            own = spread.reshape(-1, 3, 3)[use]
            joint[:, place, place] = _checked(name, own, np.flatnonzero(use))
    if part.cross_covariance is not None:
        cross = np.nan_to_num(part.cross_covariance.reshape(-1, 3, 3)[use])
        joint[:, :3, 3:], joint[:, 3:, :3] = cross, np.swapaxes(cross, 1, 2)
    return joint


def _checked(
    name: str, spread: Float[np.ndarray, "n 3 3"], rows: Int[np.ndarray, "n"]
) -> Float[np.ndarray, "n 3 3"]:
    """The same, if no matrix has a negative eigenvalue."""
    values = np.linalg.eigvalsh(spread)
    wrong = np.flatnonzero(values[:, 0] < -_ROUNDED * np.abs(values[:, 2]))
    if len(wrong):
        raise ValueError(
            f"contacts: {name}[{rows[wrong[0]]}] has the eigenvalue {values[wrong[0], 0]:.3g}; "
            "allowed are none below 0"
        )
    return spread


_ROUNDED = 0.1
"""Negative eigenvalue, relative to the largest, up to which a matrix counts: of 150 000 smoothed
contacts, three have one of up to 0.05.
"""


def pooled(given: Gathered) -> Sites:
    """Neighbours of a sweep as one, by their weighted mean; where there are too many sweeps for
    that, neighbours of every second sweep.

    The mean point of a pool lies off a curved surface by half the mean of (nᵢ − n)·(pᵢ − p), which
    is added along the mean normal.
    """
    sweep = given.sweep
    width, turn = _FINEST * given.extent, _TURN
    half = _half(given.sweep)
    while (group := _groups(sweep, given, width, turn)).max() >= _MOST:
        if width > _WIDEST * given.extent and sweep.max() > half.max():
            sweep, width, turn = half, _FINEST * given.extent, _TURN
        else:
            width, turn = 1.3 * width, 1.3 * turn
    size = np.bincount(group)
    # Of a contact whose normal is well known, the smoother knows the phase.
    weight = 1 / (np.einsum("nii->n", given.covariance[:, 3:, 3:]) + _EXACT**2)
    weight /= np.bincount(group, weight)[group]

    def mean(values: np.ndarray) -> np.ndarray:
        flat = values.reshape(len(values), -1).T * weight
        total = np.stack([np.bincount(group, column) for column in flat], axis=1)
        return total.reshape(-1, *values.shape[1:])

    point, normal = mean(given.point), mean(given.normal)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    turned, apart = given.normal - normal[group], given.point - point[group]
    point += 0.5 * mean(np.einsum("ni,ni->n", turned, apart))[:, None] * normal
    order, covariance = mean(given.order), mean(given.covariance)
    halves, of = np.zeros((2, len(size)), dtype=np.int64)
    alike, above = np.ones(len(size)), np.full(len(size), given.above)
    halves[group], of[group] = half, given.sweep
    if sweep is given.sweep:
        return Sites(point, normal, covariance, of, order, size, halves, alike, above)
    # Those of different sweeps are independent of one another; pools of neighbouring places share
    # their sweeps' errors.
    pairs = np.unique(np.column_stack([group, given.sweep]), axis=0)
    covariance /= np.bincount(pairs[:, 0])[:, None, None]
    alike *= 1 + 2 * _ALIKE * _FINEST * given.extent / width
    of = np.arange(len(size))
    return Sites(point, normal, covariance, of, order, size, halves, alike, above)


def single(given: Gathered) -> Sites:
    """Contacts as they are."""
    count, all_ = np.ones(len(given.point), dtype=np.int64), np.ones(len(given.point))
    return Sites(*given[1:6], count, _half(given.sweep), all_, given.above * all_)


def _half(sweep: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """Every second sweep is in the other half."""
    return np.unique(sweep, return_inverse=True)[1] % 2


def _groups(
    sweep: Int[np.ndarray, "n"], given: Gathered, width: float, turn: float
) -> Int[np.ndarray, "n"]:
    """Pool of each contact: those of a sweep in one cell of a lattice whose normals are alike."""
    cells = np.column_stack([given.point / width, given.normal / turn])
    cells = np.floor(cells - cells.min(axis=0)).astype(np.int64)
    key = sweep
    for column in cells.T:
        # Numbered anew at each step, so that products stay small.
        _, key = np.unique(key * (column.max() + 1) + column, return_inverse=True)
    return key


_EXACT = 1e-6
"""Error of a normal [rad] that is none."""
_TURN = 0.15
"""Change of the normals along an axis that a pool may span: less than an edge takes."""


def spread_out(points: Float[np.ndarray, "n k"], count: int) -> Int[np.ndarray, "rows"]:
    """Rows of points far from one another: each is the farthest from those before."""
    if len(points) <= count:
        return np.arange(len(points))
    rows, nearest = [0], np.full(len(points), np.inf)
    while len(rows) < count:
        nearest = np.minimum(nearest, np.sum((points - points[rows[-1]]) ** 2, axis=1))
        rows.append(int(np.argmax(nearest)))
    return np.sort(rows)
