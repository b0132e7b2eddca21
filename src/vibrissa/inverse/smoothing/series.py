"""A recording as a time series of whitened wrenches in clamp axes, and the linear steps that the
smoother takes through it.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse.smoothing.kalman import ROWS, SIZE, WRENCH, Step
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, COORDINATES, TILT, Bent, bent
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.compiled import compiled
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import PARAMETERS, SetupErrors

FREE, TIP, TANGENTIAL = (int(kind) for kind in ContactKind)
GO_ON, KINK, JUMP = 0, 1, 2
"""How a sample continues the one before: evenly, with other rates, or not at all."""
TILT_SPREAD = 3e-3
"""Standard deviation [rad] of the tilt where nothing else is known of it: a sixth of a degree, as
rods are straight and clamps are true.
"""
ARC_LENGTH_SPREAD = 0.3
"""Standard deviation of s₁ where nothing is known of it."""
_BEND = np.array([1 / 15, 1 / 15, 1 / 15, 1 / 6])
"""By how much the rates of loads and s₁ change at a change of phase, in rates of which nothing is
known: thrice what a sphere makes of them.
"""
_PINNED, _EXACT = 1e-12, 1e-6
"""Variance, and standard deviation, of what holds exactly."""
_FRICTION, _UNRELATED = 0.2, 4
"""Standard deviation of k² about ½ in tangential contact, that of a coefficient of friction of 0.4
((sin atan μ)/2), and how often in a contact it is another one.
"""
_LOAD_SPREAD = 2.0
_FAINT = 0.03
"""Weight of the whitened wrench of a swinging rod."""


_BUCKET = 512


def capacity_for(count: int) -> int:
    """Rows of a compiled loop that holds so many: few different numbers, since each is compiled
    anew.
    """
    return -(-count // _BUCKET) * _BUCKET


class NoMotionError(ArithmeticError):
    """No motion of a contact has finite likelihood: the samples are not those of a rod that slides
    along an object.
    """


class Series(NamedTuple):
    """One recording in clamp axes and model units."""

    time: Float[np.ndarray, "n"]
    turn: Float[np.ndarray, "n 3 3"]
    """From clamp to world axes."""
    wrench: Float[np.ndarray, "n 6"]
    """(f0, m0); zero where the sample is bad."""
    whitening: Float[np.ndarray, "n 6 6"]
    """W with W Σ Wᵀ = 1."""
    sound: Bool[np.ndarray, "n"]

    @property
    def step(self) -> float:
        """Usual time from one sample to the next; stamps that are given twice, or all but so, do
        not count.
        """
        steps = np.diff(self.time)
        apart = steps[steps > 0.01 * np.mean(steps)] if steps.size else steps
        return float(np.median(apart)) if apart.size else 1.0

    @property
    def whitened(self) -> Float[np.ndarray, "n 6"]:
        """Wrench in standard deviations, independent of each other."""
        return np.einsum("nij,nj->ni", self.whitening, self.wrench)


class Labels(NamedTuple):
    """What happens at each sample."""

    phase: Int[np.ndarray, "n"]
    """Values of `ContactKind`."""
    link: Int[np.ndarray, "n"]
    """GO_ON, KINK or JUMP."""
    share: Float[np.ndarray, "n"]
    """Of the time since the sample before in which the contact moved; less than 1 where it began on
    the way.
    """
    pace: Float[np.ndarray, "n"]
    """Factor of the intensities of moment and axial force."""


def series_of(rod: Rod, reactions: Reactions) -> Series:
    """Rows of one trail with known noise."""
    assert reactions.covariance is not None
    count = reactions.trail.count
    time = np.arange(count, dtype=np.float64) if reactions.time is None else reactions.time
    turn = rotation_matrices(reactions.trail.orientation)
    units = np.repeat([rod.force_scale, rod.moment_scale], 3)
    wrench = (
        np.concatenate(
            [np.einsum("nji,nj->ni", turn, part) for part in (reactions.force, reactions.moment)],
            axis=1,
        )
        / units
    )
    sound = np.isfinite(wrench).all(axis=1)
    both = np.zeros((count, WRENCH, WRENCH))
    both[:, :3, :3] = both[:, 3:, 3:] = np.swapaxes(turn, 1, 2)
    covariance = both @ (reactions.covariance / np.outer(units, units)) @ np.swapaxes(both, 1, 2)
    return Series(
        time,
        turn,
        np.where(sound[:, None], wrench, 0.0),
        np.linalg.inv(np.linalg.cholesky(covariance)),
        sound,
    )


def modulus_spread_of(friction: float | None, errors: SetupErrors | None) -> float | None:
    """Standard deviation of k² about ½ in tangential contact by what the setup tolerates; None
    where friction may make it another one.

    k² = ½ + (m0²/2EI − f0·t0)/2f, whose two parts cancel there, and each is at most ½: in the
    readings of another rod it is off by at most half of 2 δm + δf + δEI, relative, and of the
    clamp's turn [rad].
    """
    if friction != 0:
        return None
    if errors is None:
        return _EXACT
    variance = dict(zip(PARAMETERS, np.diag(errors.covariance), strict=True))
    gain_force, gain_torque, turn = (
        max(value for name, value in variance.items() if name.startswith(group))
        for group in ("gain_f", "gain_t", "clamp_orientation")
    )
    return max(
        _EXACT, math.sqrt(variance["bending_stiffness"] + gain_force + 4 * gain_torque + turn) / 2
    )


def quieted(series: Series, ringing: Bool[np.ndarray, "n"]) -> Series:
    """Samples at which the free rod swings show no load, and little of the zero's drift."""
    if not ringing.any():
        return series
    return series._replace(
        wrench=np.where(ringing[:, None], 0.0, series.wrench),
        whitening=np.where(ringing[:, None, None], _FAINT, 1.0) * series.whitening,
    )


@compiled
def _linearised(x: Float[AnyArray, "5 n"]) -> tuple[Bent, Float[Array, "10 5 n"]]:
    def observed(x: Float[Array, "5"]) -> tuple[Float[Array, "10"], Bent]:
        value = bent(x)
        return jnp.concatenate([value.wrench, value.modulus[None], value.reach]), value

    lanes = jnp.asarray(x)
    _, slope, values = jax.linearize(
        jax.vmap(observed, in_axes=1, out_axes=-1), lanes, has_aux=True
    )
    directions = jnp.eye(COORDINATES)[:, :, None] * jnp.ones_like(lanes)
    return values, jnp.stack([slope(directions[k]) for k in range(COORDINATES)], axis=1)


class Values(NamedTuple):
    """`Bent`, one row a sample."""

    wrench: Float[np.ndarray, "n 6"]
    modulus: Float[np.ndarray, "n"]
    reach: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    energy: Float[np.ndarray, "n"]


class Linear(NamedTuple):
    """What coordinates imply, and the derivatives of wrench (6), k² and reach (3) by them."""

    values: Values
    jacobian: Float[np.ndarray, "n 10 5"]

    @property
    def of_direction(self) -> Float[np.ndarray, "n 3 5"]:
        """Derivatives of n̂ = −f0/f by the coordinates."""
        direction = self.values.direction
        force = np.linalg.norm(self.values.wrench[:, :3], axis=1)
        across = np.eye(3) - np.einsum("ni,nj->nij", direction, direction)
        return -across @ self.jacobian[:, :3] / np.maximum(force, 1e-12)[:, None, None]


def linearised(x: Float[np.ndarray, "n 5"]) -> Linear:
    """The model about coordinates, in blocks of one size."""
    bent_rows = np.flatnonzero(np.any(x != AT_REST, axis=1))
    # Rods at rest are all alike: the first row is one.
    number = np.zeros(len(x), dtype=int)
    number[bent_rows] = 1 + np.arange(len(bent_rows))
    missing = -(len(bent_rows) + 1) % _BUCKET
    lanes = np.concatenate([[AT_REST], x[bent_rows], np.tile(AT_REST, (missing, 1))])
    parts = [
        _linearised(np.ascontiguousarray(block.T))
        for block in lanes.reshape(-1, _BUCKET, COORDINATES)
    ]
    values, jacobians = zip(*parts, strict=True)
    rows = (
        np.moveaxis(np.concatenate(list(map(np.asarray, field)), axis=-1), -1, 0)[number]
        for field in zip(*values, strict=True)
    )
    return Linear(
        Values(*rows),
        np.moveaxis(np.concatenate(list(map(np.asarray, jacobians)), axis=-1), -1, 0)[number],
    )


def chosen(rows: Bool[np.ndarray, "n"], first: Linear, second: Linear) -> Linear:
    """The first model in these rows, the second in the others."""

    def either(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return np.where(rows.reshape(-1, *[1] * (one.ndim - 1)), one, other)

    return Linear(
        Values(*map(either, first.values, second.values)), either(first.jacobian, second.jacobian)
    )


def exists(linear: Linear) -> Bool[np.ndarray, "n"]:
    """Whether there is a rod with these coordinates: a curvature without a zero (k² ≥ 1) has no
    contact.
    """
    return np.isfinite(linear.jacobian).all(axis=(1, 2)) & np.isfinite(linear.values.wrench).all(
        axis=1
    )


AT_REST = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
"""Coordinates of a rod that touches nothing, as it meets an object with its tip."""


def steps_of(
    series: Series,
    labels: Labels,
    about: Float[np.ndarray, "n 5"],
    weight: Float[np.ndarray, "n"],
    rates: Float[np.ndarray, "5"],
    *,
    modulus_spread: float | None,
    linear: Linear | None = None,
) -> Step:
    """The model linearised about coordinates.

    `rates` are standard deviations of rates of which nothing is known; `linear` is the model about
    these coordinates, if it is known.
    """
    keep, begin, spread, active = _transitions(labels, about, rates)
    target, design, variance = _observations(
        series, labels, about, weight, linear or linearised(about), modulus_spread=modulus_spread
    )
    duration = np.diff(series.time, prepend=series.time[0])
    return Step(duration, keep, begin, spread, active, labels.pace, target, design, variance)


def filled(steps: Step, capacity: int) -> Step:
    """With steps that see nothing and change nothing up to a fixed number of rows, so that loops
    need not be compiled for each length.
    """
    filling = [np.zeros((capacity - len(steps.duration), *part.shape[1:])) for part in steps]
    filling[1], filling[-1] = np.ones_like(filling[1]), np.full_like(filling[-1], np.inf)
    return Step(*(np.concatenate(pair) for pair in zip(steps, filling, strict=True)))


def _transitions(
    labels: Labels, about: Float[np.ndarray, "n 5"], rates: Float[np.ndarray, "5"]
) -> tuple[np.ndarray, ...]:
    phase, count = labels.phase, len(labels.phase)
    keep, begin, spread = np.ones((count, SIZE)), np.zeros((count, SIZE)), np.zeros((count, SIZE))
    places, speeds = slice(0, COORDINATES), slice(COORDINATES, 2 * COORDINATES)
    before = np.concatenate([[FREE], phase[:-1]])
    free, tip = phase == FREE, phase == TIP
    onset = ~free & (before == FREE)
    changed = ~free & (before != FREE) & (phase != before) & (labels.link == KINK)
    new_rates = ~free & ((labels.link > GO_ON) | onset) & ~changed
    keep[new_rates, speeds], spread[new_rates, speeds] = 0, rates**2
    bend = np.ix_(changed, np.arange(COORDINATES, COORDINATES + ARC_LENGTH + 1))
    spread[bend] = (_BEND * rates[: ARC_LENGTH + 1]) ** 2
    anew = ~free & (labels.link == JUMP)
    keep[anew, places] = 0
    begin[anew, :TILT] = about[anew, :TILT]
    spread[anew, :ARC_LENGTH] = _LOAD_SPREAD**2
    spread[anew, TILT] = spread[onset, TILT] = TILT_SPREAD**2
    # A contact that begins with the flank begins anywhere on the rod.
    flank = (onset | anew) & ~tip
    keep[flank, ARC_LENGTH], begin[flank, ARC_LENGTH], spread[flank, ARC_LENGTH] = (
        0,
        about[flank, ARC_LENGTH],
        ARC_LENGTH_SPREAD**2,
    )
    at_end = (ARC_LENGTH, COORDINATES + ARC_LENGTH)
    keep[np.ix_(tip, at_end)] = begin[np.ix_(tip, at_end)] = spread[np.ix_(tip, at_end)] = 0
    keep[free, : 2 * COORDINATES] = begin[free, : 2 * COORDINATES] = spread[
        free, : 2 * COORDINATES
    ] = 0
    begin[tip | free, ARC_LENGTH] = 1
    active = np.where(free[:, None], 0.0, labels.share[:, None] * np.ones(COORDINATES))
    active[tip, ARC_LENGTH] = 0
    return keep, begin, spread, active


def _observations(
    series: Series,
    labels: Labels,
    about: Float[np.ndarray, "n 5"],
    weight: Float[np.ndarray, "n"],
    linear: Linear,
    *,
    modulus_spread: float | None,
) -> tuple[np.ndarray, ...]:
    phase, count = labels.phase, len(labels.phase)
    touching, shows = phase != FREE, series.sound & exists(linear)
    values, jacobian = linear
    if not shows.all():
        values = Values(
            *(np.where(shows.reshape(-1, *[1] * (part.ndim - 1)), part, 0.0) for part in values)
        )
        jacobian = np.where(shows[:, None, None], jacobian, 0.0)
    design, target, variance = (
        np.zeros((count, ROWS, SIZE)),
        np.zeros((count, ROWS)),
        np.full((count, ROWS), np.inf),
    )
    offset = values.wrench - np.einsum("nij,nj->ni", jacobian[:, :WRENCH], about)
    moved = series.wrench - np.where(touching[:, None], offset, 0.0)
    target[:, :WRENCH] = np.einsum("nij,nj->ni", series.whitening, moved)
    design[:, :WRENCH, :COORDINATES] = np.where(
        touching[:, None, None], series.whitening @ jacobian[:, :WRENCH], 0.0
    )
    design[:, :WRENCH, 2 * COORDINATES :] = np.eye(WRENCH)
    variance[shows, :WRENCH] = 1 / weight[shows, None]
    # Where tangential contact passes over into tip contact, the arc length is the rod's.
    arrives = np.flatnonzero(
        (phase[:-1] == TANGENTIAL) & (phase[1:] == TIP) & (labels.link[1:] != JUMP)
    )
    design[arrives, WRENCH, ARC_LENGTH], target[arrives, WRENCH], variance[arrives, WRENCH] = (
        1,
        1,
        _PINNED,
    )
    square = np.flatnonzero(phase == TANGENTIAL)
    slope = jacobian[square, WRENCH]
    design[square, WRENCH + 1, :COORDINATES] = slope
    target[square, WRENCH + 1] = (
        0.5 - values.modulus[square] + np.einsum("ni,ni->n", slope, about[square])
    )
    within = (
        _FRICTION**2 * _tangential_count(phase)[square] / _UNRELATED
        if modulus_spread is None
        else modulus_spread**2
    )
    variance[square, WRENCH + 1] = np.where(shows[square], within, np.inf)
    return target, design, variance


def _tangential_count(phase: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """Samples in tangential contact of the contact that each sample belongs to."""
    contact = np.cumsum(np.diff(phase != FREE, prepend=False))
    return np.bincount(contact, phase == TANGENTIAL)[contact].astype(int)
