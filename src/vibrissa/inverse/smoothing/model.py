"""The model of a sweep: a recording as a time series of whitened wrenches in clamp axes, what
happens at each sample, how states enter a sample, what a contact shows, and which constraints hold.
Shared by offline and live smoothing.
"""

import math
from types import ModuleType
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_dilation

from vibrissa.contacts import ContactKind, Status
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import in_clamp_axes
from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import (
    DRIFT,
    PLACE,
    RATE,
    ROWS,
    SIZE,
    WRENCH,
    Gaussian,
    States,
    Step,
)
from vibrissa.inverse.smoothing.manifold import (
    ARC_LENGTH,
    AT_REST,
    COORDINATES,
    LOADS,
    TILT,
    Linear,
    Pose,
    chosen,
    finite,
    linearised,
    poses_of,
)
from vibrissa.mechanics.model import RodModel
from vibrissa.numerics.runs import runs
from vibrissa.tolerances import PARAMETERS, SetupErrors

Samples = Float[np.ndarray, "_"]
Flags = Bool[np.ndarray, "_"]
Codes = Int[np.ndarray, "_"]
Rates = Float[np.ndarray, "coordinates"]
Coordinates = Float[np.ndarray, "n coordinates"]

FREE, TIP, TANGENTIAL = (int(kind) for kind in ContactKind)
UNSEEN = -1
"""The phase before a series: if it begins in contact, it may begin with any load."""
GO_ON, KINK, JUMP = 0, 1, 2
"""How a sample continues the previous one: smoothly, with other rates, or not at all."""
TARED = Gaussian(np.zeros(WRENCH), 0.02 * np.eye(WRENCH))
"""The zero of a recording that begins at rest, in standard deviations of a sample: a tare over 50
samples."""
TILT_SPREAD = 3e-3
"""Standard deviation [rad] of the tilt if nothing else is known about it: a sixth of a degree,
typical of straight rods and true clamps.
"""
ARC_LENGTH_SPREAD = 0.3
"""Standard deviation of an unknown s₁: about that of a uniform distribution."""
TINY = 1e-300
"""Stands in for a divisor of zero."""
TOGETHER, _TOGETHER_FREE = 4, 32
"""Samples per group in contact, and without: sensors log some hundreds per second, contacts move
within tenths of a second, and zeros drift within seconds.
"""
_ROUGH_GROUPS, _GROUPS = 600, 2400
"""Most groups per contact: beyond them, computing time grows no further."""
_FAINT = 0.03
"""Weight of the whitened wrench of a swinging rod: its inertia is a hundred times the noise."""
_BEND = np.array([1 / 15, 1 / 15, 1 / 15, 1 / 6, 0])
"""How much the rates of loads and s₁ change at a change of phase, in standard deviations of unknown
rates: three times the change on a sphere.
"""
_PINNED, _EXACT = 1e-12, 1e-6
"""Variance, and standard deviation, of what holds exactly: far below the noise, far above rounding.
"""
_FRICTION, _UNRELATED = 0.2, 4
"""Standard deviation of k² about ½ in tangential contact, as for a friction coefficient of 0.4
((sin atan μ)/2), and how many independent values it takes in a contact.
"""
_LOAD_SPREAD = 2.0
"""Standard deviation of unknown loads: those of a strongly bent rod."""


class NoMotionError(ArithmeticError):
    """No motion of a contact has finite likelihood: the samples are not those of a rod sliding
    along an object.
    """


class Series(NamedTuple):
    """One recording in clamp axes and model units."""

    time: Samples
    wrench: Float[np.ndarray, "n wrench"]
    """(f0, m0) in excess of the free rod's; zero where the sample is bad."""
    whitening: Float[np.ndarray, "n wrench wrench"]
    """W with W Σ Wᵀ = 1."""
    sound: Flags
    ringing: Flags
    """Where the rod swings freely."""
    pose: Pose | None = None
    """Of a loaded rod's clamp."""
    near: Samples | None = None
    """Arc length near which a sample's contact is looked for, if there are several [L]."""

    @property
    def step(self) -> float:
        """Typical time from one sample to the next, ignoring stamps that repeat or nearly so."""
        steps = np.diff(self.time)
        return float(np.median(steps[steps > 0.01 * steps.mean()])) if steps.size else 1.0

    def whiten(self, wrench: Float[np.ndarray, "n wrench"]) -> Float[np.ndarray, "n wrench"]:
        """Wrenches in standard deviations, independent of each other."""
        return np.einsum("nij,nj->ni", self.whitening, wrench)

    @property
    def whitened(self) -> Float[np.ndarray, "n wrench"]:
        """What was measured, in standard deviations."""
        return self.whiten(self.wrench)


def series_of(
    found: Reconstruction, time: Samples, rod: RodModel, near: Samples | None = None
) -> Series:
    """Rows of one trail with known noise. Rows in which the free rod swings show no load, and
    little of the zero's drift.
    """
    wrench, covariance = in_clamp_axes(found.reactions, found.rod)
    pose = poses_of(rod, found.reactions.trail, found.rod.length)
    wrench = wrench if pose is None else wrench - pose.free
    sound, ringing = finite(wrench), found.status == Status.RINGING
    weight = np.where(ringing, _FAINT, 1.0)[:, None, None]
    return Series(
        time,
        np.where((sound & ~ringing)[:, None], wrench, 0.0),
        weight * whitening_of(covariance),
        sound & (found.status != Status.TOUCHES_TWICE),
        ringing,
        pose,
        near,
    )


def whitening_of(covariance: Float[np.ndarray, "n 6 6"] | None) -> Float[np.ndarray, "n 6 6"]:
    """W with W Σ Wᵀ = 1."""
    return np.linalg.inv(np.linalg.cholesky(np.asarray(covariance)))


class Labels(NamedTuple):
    """What happens at each sample."""

    phase: Codes
    """Values of `ContactKind`."""
    link: Codes
    """GO_ON, KINK or JUMP; at a change of phase other rates need no KINK."""
    share: Samples
    """Fraction of the time since the previous sample in which the contact moved; less than 1 if it
    began in between.
    """
    pace: Samples
    """Factor on the intensities of moment and axial force."""

    @classmethod
    def of(cls, phase: Codes) -> "Labels":
        """These phases, with nothing else happening."""
        one = np.ones(len(phase))
        return cls(phase, np.full(len(phase), GO_ON), one, one)

    def copy(self) -> "Labels":
        """Labels that may be written to."""
        return jax.tree.map(np.copy, self)

    def in_phase(self, phase: int, rows: slice) -> "Labels":
        """Labels with these rows in this phase."""
        other = self.copy()
        other.phase[rows] = phase
        return other

    def moved(self, change: int, place: int) -> "Labels":
        """Labels with the change of phase at sample `change` moved to `place`, with its link."""
        other = self.copy()
        other.phase[place:change], other.phase[change:place] = self.phase[[change, change - 1]]
        other.link[change], other.link[place] = GO_ON, self.link[change]
        return other

    @property
    def touching(self) -> Flags:
        """Samples in contact."""
        return np.not_equal(self.phase, FREE)

    @property
    def contacts(self) -> list[slice]:
        """Rows of each contact."""
        return [slice(*run) for run in runs(self.touching)]

    @property
    def begins(self) -> Flags:
        """Where the phase differs from the one before, contact or not."""
        return np.diff(self.phase, prepend=self.phase[:1]) != 0

    @property
    def breaks(self) -> Codes:
        """Samples at which something changes: phase, rates or place."""
        return np.flatnonzero((self.link > GO_ON) | self.begins)

    @property
    def changes(self) -> list[int]:
        """First samples of a new phase within contacts."""
        within = self.begins[1:] & (self.phase[1:] != FREE) & (self.phase[:-1] != FREE)
        changes: list[int] = (np.flatnonzero(within) + 1).tolist()
        return changes

    @property
    def contact(self) -> Codes:
        """Number of the contact, or of the stretch without one, that each sample belongs to."""
        return np.cumsum(np.diff(self.touching, prepend=False))


class Fit(NamedTuple):
    """A series with its labels, and what is known of its states."""

    series: Series
    labels: Labels
    linear: Linear
    at_tip: Linear
    """About the same loads, but in tip contact."""
    weight: Samples
    """1, less for outliers."""
    states: States
    rates: Rates
    """Standard deviations of unknown rates."""
    intensities: Float[np.ndarray, "intensities"]
    zero: Gaussian
    """The sensor's zero where the series begins, in standard deviations of a sample."""
    incidence_spread: float | None
    """Standard deviation of k² about ½ in tangential contact; None if friction may change it."""
    rod: RodModel

    def rows(self, rows: slice) -> "Fit":
        """Some of the samples; the zero as known from the samples before them."""
        part = Fit._make([*jax.tree.map(lambda part: part[rows], self[:6]), *self[6:]])
        return part._replace(zero=Gaussian(*(each[0] for each in part.states.expected_zero)))

    def about(self, linear: Linear) -> "Fit":
        """Linearised about other coordinates."""
        tip = linear.x.copy()
        tip[:, ARC_LENGTH] = 1
        return self._replace(linear=linear, at_tip=self.linearised(tip))

    def linearised(self, x: Coordinates) -> Linear:
        """The manifold about coordinates of each sample."""
        return linearised(self.rod, self.series.pose, x)

    def with_phases(self, labels: Labels) -> "Fit":
        """With other labels, each sample linearised about coordinates of its phase."""
        linear = chosen(labels.phase == TIP, self.at_tip, self.linear)
        return self._replace(labels=labels, linear=linear)


def incidence_spread_of(friction: float | None, errors: SetupErrors | None) -> float | None:
    """Standard deviation of k² about ½ in tangential contact within the setup's tolerances; None if
    friction may change it.

    k² = ½ + (m0²/2EI − f0·t0)/2f, whose two parts cancel there, and each is at most ½: from
    readings of a different rod it is off by at most half of 2 δm + δf + δEI, relative, and half the
    rotation of the clamp [rad].
    """
    if friction != 0 or errors is None:
        return None if friction != 0 else _EXACT
    stiffness, force, torque, turn = (
        max(
            variance
            for name, variance in zip(PARAMETERS, np.diag(errors.covariance), strict=True)
            if name.startswith(group)
        )
        for group in ("bending_stiffness", "gain_f", "gain_t", "clamp_orientation")
    )
    return max(_EXACT, math.sqrt(stiffness + force + 4 * torque + turn) / 2)


def observed(linear: Linear, wrench: Any, whitening: Any, xp: ModuleType = np) -> tuple[Any, Any]:
    """Observations of a contact, linear in its coordinates, and their derivatives: the whitened
    wrench, s₁ = 1 and k² = ½. `xp` is NumPy or its JAX counterpart.
    """
    x, value, slope = linear
    residual = (whitening @ (wrench - value.wrench)[..., None])[..., 0]
    short = 1 - x[..., ARC_LENGTH, None]
    of_short = xp.zeros_like(slope.incidence) + np.eye(COORDINATES)[ARC_LENGTH]
    rows = whitening @ slope.wrench, of_short[..., None, :], slope.incidence[..., None, :]
    away = xp.concatenate([residual, short, 0.5 - value.incidence[..., None]], axis=-1)
    slopes = xp.concatenate(rows, axis=-2)
    return away + xp.einsum("...ij,...j->...i", slopes, x), slopes


def entries(
    before: Codes,
    labels: Labels,
    x: Coordinates,
    rates: Rates,
    bend: Rates = _BEND,
    arc_length_variance: float = ARC_LENGTH_SPREAD**2,
) -> tuple[Any, Any, Any, Any]:
    """How states enter samples that follow those of phase `before`: at rest without contact, at the
    tip in tip contact, with new rates where a contact begins or breaks. The first four fields of
    `Step`.
    """
    phase, link, share, _ = labels
    tip, touching = phase == TIP, labels.touching
    anew = touching & ((link == JUMP) | (before == UNSEEN))
    begins = anew | touching & (before == FREE)
    changed = touching & ~begins & (phase != before)
    new_rates = begins | (touching & (link > GO_ON) & ~changed)
    # A contact that begins on the flank may begin anywhere on the rod.
    flank = begins & ~tip
    keep, (begin, spread) = np.ones((len(x), SIZE)), np.zeros((2, len(x), SIZE))
    keep[anew, PLACE], spread[anew, :LOADS] = 0, _LOAD_SPREAD**2
    begin[anew, :TILT] = x[anew, :TILT]
    spread[begins, TILT] = TILT_SPREAD**2
    keep[flank, ARC_LENGTH], spread[flank, ARC_LENGTH] = 0, arc_length_variance
    begin[flank, ARC_LENGTH] = x[flank, ARC_LENGTH]
    keep[new_rates, RATE], spread[new_rates, RATE] = 0, rates**2
    spread[changed, RATE] = (bend * rates) ** 2
    begin[~touching, PLACE], begin[tip, ARC_LENGTH] = AT_REST, 1
    known = ~touching[:, None] | tip[:, None] & (np.arange(COORDINATES) == ARC_LENGTH)
    for part in (keep, spread):
        part[:, : DRIFT.start][np.tile(known, 2)] = 0
    return keep, begin, spread, np.where(known, 0.0, share[:, None])


def steps_of(fit: Fit) -> Step:
    """The model linearised about the coordinates of a fit."""
    series, labels, x = fit.series, fit.labels, fit.linear.x
    phase, contact, tangential = labels.phase, labels.contact, labels.phase == TANGENTIAL
    # Without contact, or where no rod has such coordinates, nothing depends on them.
    shows = series.sound & finite(fit.linear)
    linear = chosen(shows & labels.touching, fit.linear, 0.0)
    target, slope = observed(linear, series.wrench, series.whitening)
    variance = np.full((len(phase), ROWS), np.inf)
    variance[shows, :WRENCH] = 1 / fit.weight[shows, None]
    # Where tangential contact turns into tip contact, the arc length is the rod's.
    arrives = tangential[:-1] & (phase[1:] == TIP) & (labels.link[1:] != JUMP)
    variance[:-1][arrives, WRENCH] = _PINNED
    within = (
        _FRICTION**2 * np.bincount(contact, tangential)[contact] / _UNRELATED
        if fit.incidence_spread is None
        else fit.incidence_spread**2
    )
    variance[:, WRENCH + 1] = np.where(tangential & shows, within, np.inf)
    return Step(
        *entries(np.append(UNSEEN, phase[:-1]), labels, x, fit.rates),
        np.diff(series.time, prepend=series.time[0]),
        labels.pace,
        target,
        slope,
        variance,
    )


def together_for(labels: Labels, *, rough: bool = True) -> int:
    """How many samples of a contact to group: 4 if `rough`, else 1, and more in long contacts, to
    cap the number of groups.
    """
    longest = max((rows.stop - rows.start for rows in labels.contacts), default=0)
    return max(TOGETHER, -(-longest // _ROUGH_GROUPS)) if rough else max(1, -(-longest // _GROUPS))


def group_starts(
    candidates: list[Labels], *also: Codes, together: int = TOGETHER
) -> Int[np.ndarray, "groups"]:
    """First samples of groups of 4, or of 32 without contact. A sample at which any candidate
    changes is a group by itself, and no group spans a change of a number in `also`.
    """
    touching = np.any([labels.touching for labels in candidates], axis=0)
    size, place = np.where(touching, together, _TOGETHER_FREE), np.arange(len(touching))
    breaks = np.concatenate([labels.breaks for labels in candidates])
    begins = binary_dilation(np.isin(place, breaks))
    for number in (size, *also):
        begins |= np.diff(number, prepend=0) != 0
    first = np.maximum.accumulate(np.where(begins, place, 0))
    return np.flatnonzero((place - first) % size == 0)


def merged(steps: Step, starts: Codes) -> Step:
    """One step per group of neighbouring samples, at their mean time: their observations, averaged
    by precision. They say as much about a motion that is slow by comparison, in fewer steps.
    """
    precision = 1 / steps.variance

    def averaged(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
        sums, total = (np.add.reduceat(part, starts) for part in ((values.T * weight.T).T, weight))
        return np.asarray((sums.T / np.maximum(total, TINY).T).T)

    with np.errstate(divide="ignore"):
        variance = 1 / np.add.reduceat(precision, starts)
    # Groups without observations need a middle, too.
    middle = averaged(np.cumsum(steps.duration), precision[:, 0] + 1e-12)
    first: Step = jax.tree.map(lambda part: part[starts], steps)
    return first._replace(
        duration=np.diff(middle, prepend=0.0),
        target=averaged(steps.target, precision),
        slope=averaged(steps.slope, precision),
        variance=variance,
    )


def spread_out(states: States, groups: Step, steps: Step, starts: Codes) -> States:
    """States of groups, spread to each of their samples: coordinates continue at their rates, all
    else stays the same.
    """
    number = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(steps.duration)))
    parts = jax.tree.map(lambda part: part[number], states)
    since = np.cumsum(steps.duration) - np.cumsum(groups.duration)[number]
    parts.mean[:, PLACE] += (steps.active.T * since * parts.mean[:, RATE].T).T
    for told in (parts.log_likelihood, parts.score):
        told[np.diff(number, prepend=-1) == 0] = 0
    return parts


def smoothed_states(fit: Fit, steps: Step, *, rough: bool = True) -> States:
    """States at these steps, starting from a rod at rest. Samples without contact are grouped, and
    if `rough` the others too.
    """
    starts = group_starts([fit.labels], together=together_for(fit.labels, rough=rough))
    start = kalman.at_rest(fit.zero)
    if steps.target.ndim > 2:  # several series that begin at zero
        start = start._replace(mean=np.zeros((SIZE, steps.target.shape[2])))
    groups = merged(steps, starts)
    return spread_out(kalman.smoothed(groups, fit.intensities, start), groups, steps, starts)
