"""Events between two positions, found as bracketed roots along the stretch; each evaluation solves
an equilibrium.
"""

from enum import IntEnum
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from vibrissa.contact import Law, Reached, Scene
from vibrissa.forward.march import SHARP, Steps, entering, march
from vibrissa.forward.path import Stretch, chosen, either
from vibrissa.numerics.bracket import roots


class Indicator(IntEnum):
    """Which quantity changes sign."""

    FORCE = 0
    PHASE = 1
    CONE = 2


class Place(NamedTuple):
    """A state on a stretch, with its figure and phase as in `Steps`; or one per row."""

    fraction: Float[Any, "*k"]
    reached: Reached
    figure: Float[Any, "*k"]
    phase: Float[Any, "*k"]
    onward: Any = None
    """Unit tangent of the branch in weighted coordinates, where a branch is followed."""

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
    """Where indicators cross zero on stretches (k, …), between two places. Each place tried is one
    step from the first or, without friction, from the one nearer to zero.
    """
    which = indicator[:, None, None]

    def indicated(places: Place, row: Any = slice(None)) -> Float[np.ndarray, "j n"]:
        return np.take_along_axis(places.indicators, which[row], axis=2)[..., 0]

    ends = (jax.tree.map(lambda part: part[:, None], end) for end in (low, high))
    before, after = (indicated(end)[:, 0] for end in ends)
    # With friction a state depends on its history; a branch has no memory.
    start = either(law.branch & (np.abs(after) < np.abs(before)), high, low)

    def value(
        fraction: Float[np.ndarray, "j n"], row: Int[np.ndarray, "j"]
    ) -> Float[np.ndarray, "j n"]:
        way, begin = chosen((stretches, start), row)
        return indicated(stepped(scene, law, way, begin, fraction)[0], row)

    fraction = roots(value, (low.fraction, high.fraction), (before, after))
    found = chosen(stepped(scene, law, stretches, start, fraction[:, None])[0], np.s_[:, 0])
    # Where such a step does not converge, as next to a contact that jumps or when the rod comes to
    # lie along a face, interpolate linearly between the ends.
    share = before / np.where(before == after, 1.0, before - after)
    sound = np.isfinite(found.reached.state.flat_rows).all(axis=1)
    result: Place = either(sound, found, _between(low, high, share))
    return result


def _between(low: Place, high: Place, share: Float[np.ndarray, "k"]) -> Place:
    """Linear interpolation."""
    between: Place = jax.tree.map(
        lambda first, last: first + share.reshape(-1, *(1,) * (first.ndim - 1)) * (last - first),
        low,
        high,
    )
    return between


def stepped(
    scene: Scene, law: Law, way: Stretch, start: Place, fraction: Float[np.ndarray, "k n"]
) -> tuple[Place, Float[np.ndarray, "k n"]]:
    """States at fractions (k, n) of stretches (k, …), each one step of the march from the start,
    and their residuals before the last Newton step (k, n).
    """
    fractions = np.column_stack([start.fraction, fraction])
    clamps = jax.tree.map(lambda part: part[:, None], way).clamps(fractions[..., None])
    legs = entering(scene, law, clamps)._replace(
        reached=start.reached,
        sign=np.where(start.figure > 0, 1.0, -1.0),
        fanned=np.ones(len(fraction), dtype=bool),
        tolerance=np.full(len(fraction), SHARP),
    )
    steps = march(scene, law, legs)
    found: Steps = chosen(steps, np.s_[:, 1:])
    return Place(fraction, found.reached, found.figure, found.phase), found.residual
