"""What errors of the setup do to smoothed contacts: the smoother's answer to what they change in
the wrench.

Once linearised the smoother is linear, so an error θ that adds a known column to what is observed
moves its states by the same gains with which it weighs the readings: one more pass, in which the
columns take the place of the readings (the augmented Kalman filter: de Jong, *Annals of Statistics*
19, 1991). What the drift of the zero, the tilt or the arc length take up of an error is so taken
into account, and what is known exactly, such as the arc length at the tip, stays known.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.inverse.parameters import changes_of_rows, rig_of, velocities_of
from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.fit import initial
from vibrissa.inverse.smoothing.kalman import ROWS, SIZE, WRENCH, Step
from vibrissa.inverse.smoothing.manifold import COORDINATES
from vibrissa.inverse.smoothing.merging import group_starts, merged, together_for
from vibrissa.inverse.smoothing.series import (
    FREE,
    Labels,
    Linear,
    Series,
    capacity_for,
    exists,
    filled,
)
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.compiled import compiled
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod

_STATES = 2 * COORDINATES
Columns = Float[Array, "16 k"]


class Passed(NamedTuple):
    """What the way back needs of the way there."""

    covariance: Float[Array, "10 16"]
    """Predicted, of coordinates and rates with all states."""
    spread: Float[Array, "8"]
    gain: Float[Array, "8 16"]
    columns: Float[Array, "10 k"]
    """Predicted."""
    innovation: Float[Array, "8 k"]


def smoothed_sensitivity(
    rod: Rod,
    reactions: Reactions,
    series: Series,
    labels: Labels,
    steps: Step,
    linear: Linear,
    intensities: Float[np.ndarray, "5"],
) -> Float[np.ndarray, "n 6 15"]:
    """Derivatives of points and normals, world axes, by `vibrissa.tolerances.PARAMETERS` for given
    readings, lengths in units of the rod's.

    Parameters
    ----------
    rod, reactions, series, labels
        Of one trail.
    steps, linear
        The model linearised about the smoothed coordinates.
    intensities
        As estimated.
    """
    values, jacobian = linear
    touching = (labels.phase != FREE)[:, None, None]
    velocity = velocities_of(rod, reactions)
    seen = changes_of_rows(
        values.wrench, values.reach, values.direction, velocity, rig_of(rod, reactions)
    )
    # A larger wrench for the same contact makes of the same readings a smaller one; samples of
    # which there is no rod are not seen.
    observed = np.where(
        touching & exists(linear)[:, None, None], -series.whitening @ seen.wrench, 0.0
    )
    moved = _coordinates(steps, labels, observed, intensities)
    reach = series.turn @ (jacobian[:, WRENCH + 1 :] @ moved + seen.reach)
    direction = series.turn @ (linear.of_direction @ moved + seen.direction)
    return np.where(touching, np.concatenate([reach, direction], axis=1), np.nan)


def _coordinates(
    steps: Step,
    labels: Labels,
    observed: Float[np.ndarray, "n 6 k"],
    intensities: Float[np.ndarray, "5"],
) -> Float[np.ndarray, "n 5 k"]:
    """Of the smoothed contact, for columns in the place of the whitened wrench; taken in the same
    groups of samples.
    """
    starts = group_starts([labels], together=together_for(labels))
    groups, count = merged(steps, starts), len(steps.duration)
    number = np.repeat(np.arange(len(starts)), np.diff(starts, append=count))
    seen = np.isfinite(steps.variance[:, :WRENCH])
    share = np.where(seen, groups.variance[number, :WRENCH], 0.0) / np.where(
        seen, steps.variance[:, :WRENCH], 1.0
    )
    capacity = capacity_for(len(starts))
    targets = np.zeros((capacity, ROWS, observed.shape[2]))
    targets[: len(starts), :WRENCH] = np.add.reduceat(share[..., None] * observed, starts)
    _, covariance = initial()
    found = np.asarray(
        _smoothed_columns(
            filled(groups, capacity), np.array(len(starts)), intensities, covariance, targets
        )
    )[number]
    time = np.cumsum(steps.duration)
    away = steps.active * (time - np.cumsum(groups.duration)[number])[:, None]
    return found[:, :COORDINATES] + away[..., None] * found[:, COORDINATES:]


@compiled
def _smoothed_columns(
    steps: Step,
    count: Int[AnyArray, ""],
    intensities: Float[AnyArray, "5"],
    covariance: Float[AnyArray, "16 16"],
    targets: Float[AnyArray, "n 8 k"],
) -> Float[Array, "n 10 k"]:
    """Coordinates and rates given all samples, for each column of targets; states begin at zero."""
    steps, targets, last_row = (
        Step(*map(jnp.asarray, steps)),
        jnp.asarray(targets),
        jnp.asarray(count) - 1,
    )
    rows, width = targets.shape[0], targets.shape[2]

    def forward(row: Array, carry: tuple[Columns, Array, Passed]) -> tuple[Columns, Array, Passed]:
        step = kalman.row_of(steps, row)
        _, spread = kalman.predicted(jnp.zeros(SIZE), carry[1], step, jnp.asarray(intensities))
        before = kalman.moved(step, jnp.asarray(step.keep)[:, None] * carry[0])
        _, left, trace, _ = kalman.updated(jnp.zeros(SIZE), spread, step)
        columns, innovations = kalman.columns_updated(before, step, trace, targets[row])
        passed = Passed(spread[:_STATES], trace.spread, trace.gain, before[:_STATES], innovations)
        return columns, left, kalman.with_row(carry[2], row, passed)

    nothing = Passed(
        *(
            jnp.zeros((rows, *shape))
            for shape in ((_STATES, SIZE), (ROWS,), (ROWS, SIZE), (_STATES, width), (ROWS, width))
        )
    )
    passed: Passed = lax.fori_loop(
        0, count, forward, (jnp.zeros((SIZE, width)), jnp.asarray(covariance), nothing)
    )[2]

    def backward(number: Array, carry: tuple[Columns, Array]) -> tuple[Columns, Array]:
        row = last_row - number
        step, trace, pull = kalman.row_of(steps, row), kalman.row_of(passed, row), carry[0]
        for j in reversed(range(ROWS)):
            pull = pull + jnp.outer(
                step.design[j], trace.innovation[j] / trace.spread[j] - trace.gain[j] @ pull
            )
        told = trace.columns + trace.covariance @ pull
        return kalman.moved_back(step, pull), lax.dynamic_update_index_in_dim(
            carry[1], told, row, 0
        )

    found: Array = lax.fori_loop(
        0, count, backward, (jnp.zeros((SIZE, width)), jnp.zeros((rows, _STATES, width)))
    )[1]
    return found
