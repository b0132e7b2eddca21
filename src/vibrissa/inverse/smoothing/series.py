"""A recording as a time series of whitened wrenches in clamp axes, what happens at each sample, and
a fit to it.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse.smoothing.kalman import (
    Gaussian,
    States,
)
from vibrissa.inverse.smoothing.manifold import (
    ARC_LENGTH,
    Linear,
    chosen,
    linearised,
)
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod

Samples = Float[np.ndarray, "n"]
Flags = Bool[np.ndarray, "n"]
Codes = Int[np.ndarray, "n"]
Rates = Float[np.ndarray, "coordinates"]

FREE, TIP, TANGENTIAL = (int(kind) for kind in ContactKind)
GO_ON, KINK, JUMP = 0, 1, 2
"""How a sample continues the one before: evenly, with other rates, or not at all."""
_FAINT = 0.03
"""Weight of the whitened wrench of a swinging rod: its inertia is a hundred times the noise."""


class NoMotionError(ArithmeticError):
    """No motion of a contact has finite likelihood: the samples are not those of a rod that slides
    along an object.
    """


class Series(NamedTuple):
    """One recording in clamp axes and model units."""

    time: Samples
    turn: Float[np.ndarray, "n 3 3"]
    """From clamp to world axes."""
    wrench: Float[np.ndarray, "n wrench"]
    """(f0, m0); zero where the sample is bad."""
    whitening: Float[np.ndarray, "n wrench wrench"]
    """W with W Σ Wᵀ = 1."""
    sound: Flags

    @property
    def step(self) -> float:
        """Usual time from one sample to the next; stamps that are given twice, or all but so, do
        not count.
        """
        steps = np.diff(self.time)
        apart = steps[steps > 0.01 * np.mean(steps)] if steps.size else steps
        return float(np.median(apart)) if apart.size else 1.0

    @property
    def whitened(self) -> Float[np.ndarray, "n wrench"]:
        """Wrench in standard deviations, independent of each other."""
        return np.einsum("nij,nj->ni", self.whitening, self.wrench)


class Labels(NamedTuple):
    """What happens at each sample."""

    phase: Codes
    """Values of `ContactKind`."""
    link: Codes
    """GO_ON, KINK or JUMP."""
    share: Samples
    """Of the time since the sample before in which the contact moved; less than 1 where it began on
    the way.
    """
    pace: Samples
    """Factor of the intensities of moment and axial force."""

    def copy(self) -> "Labels":
        """Labels to write into."""
        return Labels(*(part.copy() for part in self))

    @property
    def begins(self) -> Flags:
        """Where the phase is another one than before, contact or not."""
        return np.diff(self.phase, prepend=FREE) != 0

    @property
    def changes(self) -> list[int]:
        """First samples of a new phase within contacts."""
        phase = self.phase
        within = (phase[1:] != phase[:-1]) & (phase[1:] != FREE) & (phase[:-1] != FREE)
        return [int(row) for row in np.flatnonzero(within) + 1]

    @property
    def contact(self) -> Codes:
        """Number of the contact, or of the stretch without, that each sample belongs to."""
        return np.cumsum(np.diff(self.phase != FREE, prepend=False))


class Fit(NamedTuple):
    """A series with its labels, and what is known of its states."""

    series: Series
    labels: Labels
    linear: Linear
    at_tip: Linear
    """About the same loads in tip contact."""
    weight: Samples
    """1, less for outliers."""
    states: States
    rates: Rates
    """Standard deviations of rates of which nothing is known."""
    intensities: Float[np.ndarray, "intensities"]
    zero: Gaussian
    """The sensor's zero where the series begins, in standard deviations of a sample."""
    incidence_spread: float | None
    """Standard deviation of k² about ½ in tangential contact; None where friction may make it
    another one.
    """

    def rows(self, rows: slice) -> "Fit":
        """Some of the samples."""
        given = self._asdict()
        each = ("series", "labels", "linear", "at_tip", "weight", "states")
        parts: dict[str, Any] = {
            name: jax.tree.map(lambda part: part[rows], given[name]) for name in each
        }
        return self._replace(**parts)

    def about(self, linear: Linear) -> "Fit":
        """About other coordinates."""
        tip = linear.x.copy()
        tip[:, ARC_LENGTH] = 1
        return self._replace(linear=linear, at_tip=linearised(tip))

    def with_phases(self, labels: Labels) -> "Fit":
        """With other labels, each sample about coordinates of its phase."""
        tip = labels.phase == TIP
        return self._replace(labels=labels, linear=chosen(tip, self.at_tip, self.linear))


def series_of(rod: Rod, reactions: Reactions, ringing: Flags) -> Series:
    """Rows of one trail with known noise. Those at which the free rod swings show no load, and
    little of the zero's drift.
    """
    assert reactions.covariance is not None
    count = reactions.trail.count
    time = np.arange(count, dtype=np.float64) if reactions.time is None else reactions.time
    turn = rotation_matrices(reactions.trail.orientation)
    units = np.repeat([rod.force_scale, rod.moment_scale], 3)
    both = np.kron(np.eye(2), np.swapaxes(turn, 1, 2))
    world = np.concatenate([reactions.force, reactions.moment], axis=1)
    wrench = np.einsum("nij,nj->ni", both, np.nan_to_num(world)) / units
    sound = np.isfinite(world).all(axis=1)
    covariance = both @ (reactions.covariance / np.outer(units, units)) @ np.swapaxes(both, 1, 2)
    weight = np.where(ringing, _FAINT, 1.0)[:, None, None]
    return Series(
        time,
        turn,
        np.where((sound & ~ringing)[:, None], wrench, 0.0),
        weight * np.linalg.inv(np.linalg.cholesky(covariance)),
        sound,
    )
