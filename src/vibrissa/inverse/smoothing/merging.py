"""Neighbouring samples taken together: they tell as much of a motion that is slow against them, in
fewer steps.
"""

import jax
import numpy as np
from jaxtyping import Float, Int

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import PLACE, RATE, States, Step
from vibrissa.inverse.smoothing.series import FREE, GO_ON, Fit, Flags, Labels

Starts = Int[np.ndarray, "groups"]

TOGETHER, _TOGETHER_FREE = 4, 32
"""Samples of a group in contact, and without: a sensor logs some hundred a second, contacts move
within tenths of one, and drifts within seconds."""
_ROUGH_GROUPS, _GROUPS = 600, 2400
"""Most groups of a contact: time grows no further."""
_TINY = 1e-300
"""In place of a divisor of zero."""


def together_for(labels: Labels, *, rough: bool = True) -> int:
    """How many samples of a contact to take together: 4 where it is rough, else 1, and more in long
    contacts, which have so many groups at most.
    """
    longest = int(np.bincount(np.cumsum(labels.phase == FREE), labels.phase != FREE).max(initial=0))
    return max(TOGETHER, -(-longest // _ROUGH_GROUPS)) if rough else max(1, -(-longest // _GROUPS))


def group_starts(
    candidates: list[Labels], also: Flags | None = None, together: int = TOGETHER
) -> Starts:
    """First samples of groups of 4, or of 32 without contact; in none of the candidates something
    changes within a group or where one begins.
    """
    count = len(candidates[0].phase)
    begins, place = np.zeros(count + 1, dtype=bool), np.arange(count)
    begins[0], size = True, np.full(count, _TOGETHER_FREE)
    if also is not None:
        begins[:-1] |= also
    for labels in candidates:
        changed = np.diff(labels.phase, prepend=labels.phase[0]) != 0
        changes = np.flatnonzero(changed | (labels.link > GO_ON))
        begins[np.concatenate([np.maximum(changes - 1, 0), changes, changes + 1])] = True
        size[labels.phase != FREE] = together
    begins = begins[:-1]
    begins |= np.diff(size, prepend=size[0]) != 0
    first = np.maximum.accumulate(np.where(begins, place, 0))
    return np.flatnonzero((place - first) % size == 0)


def groups_of(labels: Labels, also: Flags | None = None, *, rough: bool = True) -> Starts:
    """First samples of the groups that one series is taken in."""
    return group_starts([labels], also, together_for(labels, rough=rough))


def merged(steps: Step, starts: Starts) -> Step:
    """One step for each group of samples, at their mean time: what they show, averaged by its
    precision.
    """
    precision = 1 / steps.variance
    total = np.add.reduceat(precision, starts)
    sizes = np.diff(starts, append=len(precision))
    weight = precision / np.repeat(np.maximum(total, _TINY), sizes, axis=0)
    target = weight.reshape(*weight.shape, *[1] * (steps.target.ndim - 2)) * steps.target
    with np.errstate(divide="ignore"):
        variance = 1 / total
    return Step(
        jax.tree.map(lambda part: part[starts], steps.entry),
        np.diff(_middle(steps, starts), prepend=0.0),
        steps.pace[starts],
        np.add.reduceat(target, starts),
        np.add.reduceat(weight[..., None] * steps.slope, starts),
        variance,
    )


def spread_out(states: States, steps: Step, starts: Starts) -> States:
    """States of groups, for each of their samples: coordinates go on at their rates, all else is
    the same.
    """
    time = np.cumsum(steps.duration)
    number = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(time)))
    parts = States(*(part[number] for part in states))
    since = steps.entry.active * (time - _middle(steps, starts)[number])[:, None]
    parts.mean[:, PLACE] += (since.T * parts.mean[:, RATE].T).T
    parts.log_likelihood[np.diff(number, prepend=-1) == 0] = 0
    return parts


def _middle(steps: Step, starts: Starts) -> Float[np.ndarray, "groups"]:
    # Groups of which nothing is seen have a middle, too.
    share = 1 / steps.variance[:, 0] + 1e-12
    return np.asarray(
        np.add.reduceat(share * np.cumsum(steps.duration), starts) / np.add.reduceat(share, starts)
    )


def smoothed_states(fit: Fit, steps: Step, *, rough: bool = True) -> States:
    """States at these steps, from a rod at rest on. Samples without contact are taken together, and
    others too where it is rough.
    """
    starts = groups_of(fit.labels, rough=rough)
    start = kalman.at_rest(fit.zero)
    if steps.target.ndim > 2:  # several series that begin at zero
        start = start._replace(mean=np.zeros((kalman.SIZE, steps.target.shape[2])))
    states = kalman.smoothed(merged(steps, starts), fit.intensities, start)
    return spread_out(states, steps, starts)
