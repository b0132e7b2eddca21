"""Neighbouring samples taken together: they tell as much of a motion that is slow against them, in
fewer steps.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.inverse.smoothing.kalman import States, Step
from vibrissa.inverse.smoothing.manifold import COORDINATES
from vibrissa.inverse.smoothing.series import FREE, GO_ON, Labels

TOGETHER, _TOGETHER_FREE = 4, 32
_ROUGH_GROUPS, _GROUPS = 600, 2400


def together_for(labels: Labels, *, rough: bool = True) -> int:
    """How many samples of a contact to take together: 4 where it is rough, else 1, and more in long
    contacts, which have so many groups at most.
    """
    longest = int(np.bincount(np.cumsum(labels.phase == FREE), labels.phase != FREE).max(initial=0))
    return max(TOGETHER, -(-longest // _ROUGH_GROUPS)) if rough else max(1, -(-longest // _GROUPS))


def group_starts(
    candidates: list[Labels], also: Bool[np.ndarray, "n"] | None = None, together: int = TOGETHER
) -> Int[np.ndarray, "g"]:
    """First samples of groups of 4, or of 32 without contact; in none of the candidates something
    changes within a group or where one begins.
    """
    count = len(candidates[0].phase)
    begins, place = np.zeros(count + 1, dtype=bool), np.arange(count)
    begins[0], size = True, np.full(count, _TOGETHER_FREE)
    if also is not None:
        begins[:-1] |= also
    for labels in candidates:
        changes = np.flatnonzero(
            (np.diff(labels.phase, prepend=labels.phase[0]) != 0) | (labels.link > GO_ON)
        )
        begins[np.concatenate([np.maximum(changes - 1, 0), changes, changes + 1])] = True
        size[labels.phase != FREE] = together
    begins = begins[:-1]
    begins |= np.diff(size, prepend=size[0]) != 0
    first = np.maximum.accumulate(np.where(begins, place, 0))
    return np.flatnonzero((place - first) % size == 0)


def merged(steps: Step, starts: Int[np.ndarray, "g"]) -> Step:
    """One step for each group of samples, at their mean time: what they show, averaged by its
    precision.
    """
    precision = np.where(np.isfinite(steps.variance), 1 / np.asarray(steps.variance), 0.0)
    total = np.add.reduceat(precision, starts)
    weight = precision / np.repeat(
        np.maximum(total, 1e-300), np.diff(starts, append=len(precision)), axis=0
    )
    middle = _middle(steps, starts)
    return Step(
        np.diff(middle, prepend=0.0),
        steps.keep[starts],
        steps.begin[starts],
        steps.spread[starts],
        steps.active[starts],
        steps.pace[starts],
        np.add.reduceat(weight * steps.target, starts),
        np.add.reduceat(weight[..., None] * steps.design, starts),
        np.where(total > 0, 1 / np.maximum(total, 1e-300), np.inf),
    )


def spread_out(states: States, steps: Step, starts: Int[np.ndarray, "g"]) -> States:
    """States of groups, for each of their samples: coordinates go on at their rates, all else is
    the same.
    """
    time, middle = np.cumsum(steps.duration), _middle(steps, starts)
    number = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(time)))
    parts = States(*(part[number] for part in states))
    parts.mean[:, :COORDINATES] += (steps.active * (time - middle[number])[:, None]) * parts.mean[
        :, COORDINATES : 2 * COORDINATES
    ]
    return parts._replace(
        log_likelihood=np.where(np.diff(number, prepend=-1) > 0, parts.log_likelihood, 0.0)
    )


def _middle(steps: Step, starts: Int[np.ndarray, "g"]) -> Float[np.ndarray, "g"]:
    share = (
        np.where(np.isfinite(steps.variance[:, 0]), 1 / np.asarray(steps.variance[:, 0]), 0.0)
        + 1e-12
    )
    return np.asarray(
        np.add.reduceat(share * np.cumsum(steps.duration), starts) / np.add.reduceat(share, starts)
    )
