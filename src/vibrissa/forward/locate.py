"""Events between two positions: bracketed roots along the way, each evaluation an equilibrium of
its own.
"""

from enum import IntEnum
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from vibrissa.contact import Law, Reached, Scene
from vibrissa.forward.march import Legs, Mode, Steps, march
from vibrissa.forward.path import Stretch, chosen, either
from vibrissa.numerics.bracket import roots


class Indicator(IntEnum):
    """Which figure changes its sign."""

    FORCE = 0
    PHASE = 1
    CONE = 2


class Place(NamedTuple):
    """A state on a stretch, with its figure and phase as in `Steps`; or one a row."""

    fraction: Float[Any, "*k"]
    reached: Reached
    figure: Float[Any, "*k"]
    phase: Float[Any, "*k"]
    onward: Any = None
    """Unit tangent of its branch in weighted coordinates, where that is followed."""

    @property
    def indicators(self) -> Float[np.ndarray, "*k three"]:
        """Values of each `Indicator`."""
        return np.stack([self.reached.state.force, self.phase, self.figure], axis=-1)


def located(
    scene: Scene,
    law: Law,
    stretches: Stretch,
    low: Place,
    high: Place,
    indicator: Int[np.ndarray, "k"],
) -> Place:
    """Where indicators pass zero on stretches (k, …), between two places; with friction each a
    step from the first.
    """
    rows = np.arange(len(low.fraction))

    def indicated(places: Place, row: Int[np.ndarray, "j"]) -> Float[np.ndarray, "j"]:
        return np.take_along_axis(places.indicators, indicator[row, None], axis=1)[:, 0]

    before, after = indicated(low, rows), indicated(high, rows)
    found = jax.tree.map(np.array, either(np.abs(before) <= np.abs(after), low, high))

    def value(fraction: Float[np.ndarray, "j"], row: Int[np.ndarray, "j"]) -> np.ndarray:
        start, last, way = chosen((low, found, stretches), row)
        if law.branch:
            start = either(np.isfinite(last.phase), last, start)
        place, _ = stepped(scene, law, way, start, fraction)
        if law.branch:
            # Figure and phase are those before Newton's last step: on the spot, those of the state.
            place, _ = stepped(scene, law, way, place, fraction)
        for whole, part in zip(jax.tree.leaves(found), jax.tree.leaves(place), strict=True):
            whole[row] = part
        return indicated(place, row)

    roots(value, (low.fraction, high.fraction), (before, after))
    # Where a step on the way does not converge, as next to a contact that jumps or of a rod that
    # comes to lie along a face, what lies between the ends in proportion.
    share = before / np.where(before == after, 1.0, before - after)
    sound = np.isfinite(found.reached.state.flat_rows).all(axis=1)
    result: Place = either(sound, found, _between(low, high, share))
    return result


def _between(low: Place, high: Place, share: Float[np.ndarray, "k"]) -> Place:
    """In proportion."""
    between: Place = jax.tree.map(
        lambda first, last: first + share.reshape(-1, *(1,) * (first.ndim - 1)) * (last - first),
        low,
        high,
    )
    return between


def stepped(
    scene: Scene, law: Law, way: Stretch, start: Place, fraction: Float[np.ndarray, "k"]
) -> tuple[Place, Float[np.ndarray, "k"]]:
    """States at fractions (k,) of stretches, one step of the march from the start, and their
    residuals before Newton's last step (k,).
    """
    fractions = np.column_stack([start.fraction, fraction])
    clamps = jax.tree.map(lambda part: part[:, None], way).clamps(fractions[..., None])
    never = np.zeros(fractions.shape, dtype=bool)
    meeting = jax.tree.map(
        lambda part: np.zeros((*fractions.shape, *part.shape[1:])), start.reached
    )
    legs = Legs(
        clamps,
        never,
        never,
        meeting,
        np.zeros(len(fraction), dtype=int),
        np.full(len(fraction), int(Mode.CONTACT)),
        start.reached,
        np.where(start.figure > 0, 1.0, -1.0),
    )
    steps = march(scene, law, legs)
    found: Steps = chosen(steps, np.s_[:, 1])
    return Place(fraction, found.reached, found.figure, found.phase), found.residual
