"""The clamp's work on the rod against the rod's bending energy: a test of the numbers against each
other.

A rod that is free at first takes up the work W = ∫ f0·dx + m0·dω of its clamp. What is not bending
energy U was lost, by friction or in a snap, and a loss never comes back: W − U starts at zero and
does not fall. U follows from each wrench by itself (mechanics.md, "Uniform straight rod"), W from
wrenches and the clamp's way: units, signs and axes that are mistaken for others leave the two
apart.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int
from scipy.ndimage import median_filter
from scipy.special import chdtri

from vibrissa.geometry.rotation import rotation_vectors
from vibrissa.inverse.kernels import Sample, exact_contacts
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import setting_of
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import PARAMETERS

_FALSE_ALARM = 1e-9
"""Of a row that is loaded: less than one in any recording."""
_LEAST_LOAD = 0.02
"""The same without stated noise, of the largest force."""
_BLOCKS, _FEWEST = 64, 24
"""Means over a contact, which follow its course, and the fewest rows that make one."""
_FREE_ROWS = 3
"""On end, which part two contacts; noise hides a weak load for fewer."""
_LARGEST_GAP = 0.02
"""Share of a contact's rows that may be missing."""
_EARLIER, _PARTED = 4, 0.1
"""Part of a contact's duration before it, and the share of loaded rows there from which it is the
rest of another: where a load rises out of the noise some are loaded, too.
"""
_LOADING = 0.9
"""Of the largest energy: up to there the rod is loaded first."""
_LEAST_WAY, _SHARE_OF_BEND = 0.01, 0.1
"""Ways of the clamp: of the rod's length, below which a rod stores next to nothing; and of the
tip's deflection, below which the clamp hardly moves.
"""
_CLEARLY_MOVES = 10.0
"""Of the noise of a position: the farthest of ten thousand is four from where it is, and so is the
first.
"""
_GAINED, _DEVIATIONS = 0.05, 6.0
"""Sound recordings, also with friction and snaps: at most 0.02 by their noise and the mean over
rows. EI 5 % off is as much; the checks of the sweep are finer.
"""
_MOST_BY_FRICTION = 4.0
"""Sliding with a coefficient of 0.75 takes no more than the rod takes up while it is loaded first.
"""
_BY_GAIN = 4.0
"""Energy goes with the torques' square, and with the length that they say is bent: 2 % too much
torque is 7.6 % of it.
"""
_TINY = 1e-300
_NEAR = (0.9, 1.2)
"""Friction raises the ratio, EI and gains move it."""
_KNOWN_RATIOS = {
    1e2: "positions in centimetres, taken for metres?",
    1e3: "positions in millimetres, taken for metres, or forces and torques a thousand times too "
    "small?",
    1e-3: "forces and torques in mN and N mm, or positions a thousand times too small?",
    39.370: "positions in inches, taken for metres?",
    9.80665: "forces and torques in kgf and kgf m, taken for N and N m?",
    4.4482: "forces and torques in lbf, taken for N?",
    16.0: "the rod's diameter, taken for its radius?",
    -1.0: "the other sign of the wrench, or a sensor turned by half a turn?",
}
_ELSE = (
    "check the units, the order of the quaternions, sign and axes of the wrench, the gain, EI and "
    "length of the rod, and the tare"
)


@dataclass(frozen=True, eq=False)
class ClampWork:
    """Work of the clamp and bending energy over one contact, in its order (k,), each the mean of a
    few rows.

    Attributes
    ----------
    row
        Middle rows.
    work, energy
        [J]; the work is zero where the contact begins.
    ratio, ratio_deviation
        Work over energy while the rod is loaded first, up to nine tenths of the largest energy, and
        its standard deviation, as below: 1 without friction, above it with friction.
    gained
        Largest fall of W − U as a share of the largest energy: energy from nowhere. Zero but for
        noise, also with friction and snaps.
    remainder
        Work at the end as a share of the largest energy: zero without friction and snaps. NaN where
        the contact does not end.
    deviation
        Standard deviation of `gained` and `remainder` by the noise, as far as it makes the work.
    energy_deviation
        Relative standard deviation of the energies by the noise, and by stiffness and gains as well
        as these are said to be known.
    """

    row: Float[np.ndarray, "k"]
    work: Float[np.ndarray, "k"]
    energy: Float[np.ndarray, "k"]
    ratio: float
    ratio_deviation: float
    gained: float
    remainder: float
    deviation: float
    energy_deviation: float

    @property
    def impossible(self) -> bool:
        """Whether no single contact on this rod explains it, with whatever friction up to a
        coefficient of 0.75.
        """
        deviation = math.hypot(self.ratio_deviation, self.energy_deviation)
        return self.gains or self.ratio > _MOST_BY_FRICTION + _DEVIATIONS * deviation

    @property
    def gains(self) -> bool:
        """Whether energy comes from nowhere."""
        deviation = math.hypot(self.deviation, self.energy_deviation)
        return self.gained > _GAINED + _DEVIATIONS * deviation

    @property
    def misfit(self) -> float:
        """Root mean square of W − U as a share of the largest energy, 0 where nothing is lost."""
        return float(np.sqrt(np.mean((self.work - self.energy) ** 2)) / self.energy.max())


class _Load(NamedTuple):
    """Reactions of the rows that hold numbers, and the stretches of them under load."""

    rows: Int[np.ndarray, "m"]
    reactions: Reactions
    loaded: Bool[np.ndarray, "m"]
    spans: list[tuple[int, int]]
    """[start, stop) of contacts that begin and last long enough, parted where the rod is free for
    some rows on end.
    """


def clamp_work(rod: Rod, reactions: Reactions) -> list[ClampWork]:
    """Work and energy of each contact of one trail that begins with the rod free and lasts long
    enough to be judged; in order of the rows, stamps are not needed.

    Raises
    ------
    ValueError
        If the reactions are of several trails.
    """
    if reactions.force.ndim != 2:
        raise ValueError(f"reactions of shape {reactions.force.shape}: allowed is one trail (n, …)")
    load = _load(reactions)
    if load is None:
        return []
    found, before = [], 0
    for start, stop in load.spans:
        # Noise may part a weak contact, and of its rest the earlier work is not known.
        earlier = load.loaded[max(0, start - (stop - start) // _EARLIER) : start]
        begins = start > 0 and np.mean(earlier) < _PARTED
        missing = load.rows[stop - 1] - load.rows[start] + 1 - (stop - start)
        # Where the clamp stands, it is the object that moves, and works.
        moves = _way(rod, load.reactions, slice(start, stop)) > _LEAST_WAY * rod.length
        if begins and missing <= _LARGEST_GAP * (stop - start) and moves:
            found.append(_of_contact(rod, load, before, start, stop))
        before = stop
    return found


def work_warnings(found: Reconstruction) -> list[str]:
    """One line on clamp work that no contact explains, with the likeliest mistake where the ratio
    is that of a known one; empty for sound sweeps, also with friction.

    Parameters
    ----------
    found
        Contacts of a recording. Of reactions without stamps or noise, or of a few rows, nothing is
        said: `clamp_work` gives the figures.
    """
    wrong = [work for work in clamp_work(found.rod, found.reactions) if work.impossible]
    if not wrong:
        return []
    worst = max(wrong, key=lambda work: work.energy.max())
    text = (
        f"the clamp's work is {worst.ratio:.3g} times the rod's bending energy while it is loaded "
        f"(1 without friction, up to {_MOST_BY_FRICTION:g} with it)"
    )
    if worst.gains:
        share = f"{worst.gained:.0%} of the largest energy come"
        text += f", and {share if worst.gained < 1 else 'energy comes'} from nowhere"
    low, high = _NEAR
    guesses = [words for ratio, words in _KNOWN_RATIOS.items() if low < worst.ratio / ratio < high]
    return [f"{text}: {[*guesses, _ELSE][0]}"]


def still_warnings(found: Reconstruction) -> tuple[list[str], bool]:
    """One line where the rod is loaded and released while its clamp hardly moves, and whether it
    moves at all.

    Where it stands the object may move; where it moves a little the poses are misread.
    """
    rod, load = found.rod, _load(found.reactions)
    if found.reactions.covariance is None or load is None:
        return [], False
    contacts = [slice(start, stop) for start, stop in load.spans if start > 0]
    ways = [_way(rod, load.reactions, rows) for rows in contacts]
    forces = [np.linalg.norm(load.reactions.force[rows], axis=1).max() for rows in contacts]
    # By so much a force bends the rod's tip at first; the clamp has to go about as far.
    bent = np.array(forces) * rod.length / (3 * rod.force_scale)
    if not ways or np.any(ways > _SHARE_OF_BEND * bent):
        return [], False
    variance = found.reactions.position_covariance
    noise = 0.0 if variance is None else float(np.sqrt(np.trace(variance)))
    moves = max(ways) > _CLEARLY_MOVES * noise and max(ways) > 0
    size = f"{1e3 * max(ways):.2g} mm" if rod.units == "SI" else f"{max(ways):.2g} L"
    causes = (
        "positions in m, taken for mm?"
        if moves
        else "a pose stream that stands still? It is right only if the object moves"
    )
    return [
        f"the clamp moves by no more than {size} while the rod is loaded and released: {causes}"
    ], moves


def _load(reactions: Reactions) -> _Load | None:
    """None where no row holds numbers."""
    rows = np.flatnonzero(np.isfinite(reactions.force + reactions.moment).all(axis=1))
    if not rows.size:
        return None
    given = reactions if rows.size == len(reactions.force) else reactions[rows]
    if given.covariance is None:
        size = np.linalg.norm(given.force, axis=1)
        loaded = size > _LEAST_LOAD * size.max()
    else:
        weight = np.linalg.inv(given.covariance[..., :3, :3])
        square = np.sum((given.force[:, None, :] @ weight)[:, 0] * given.force, axis=1)
        loaded = square > chdtri(3, _FALSE_ALARM)
    places = np.flatnonzero(loaded)
    runs = np.split(places, np.flatnonzero(np.diff(places) > _FREE_ROWS) + 1)
    spans = [(int(run[0]), int(run[-1]) + 1) for run in runs if run.size]
    return _Load(rows, given, loaded, [one for one in spans if one[1] - one[0] >= _FEWEST])


def _way(rod: Rod, reactions: Reactions, rows: slice) -> float:
    """How far the clamp goes, and the tip by its turning."""
    far, turned = _farthest(reactions, rows)
    return far + rod.length * turned


def _farthest(reactions: Reactions, rows: slice) -> tuple[float, float]:
    """How far the clamp goes from where it is at first, and by how much it turns."""
    position, orientation = reactions.trail.position[rows], reactions.trail.orientation[rows]
    turned = rotation_vectors(np.broadcast_to(orientation[0], orientation.shape), orientation)
    far, angle = (
        float(np.linalg.norm(part, axis=1).max()) for part in (position - position[0], turned)
    )
    return far, angle


def _moved(reactions: Reactions) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
    """Way and turn of the clamp from each row to the next."""
    position, orientation = reactions.trail.position, reactions.trail.orientation
    return np.diff(position, axis=0), rotation_vectors(orientation[:-1], orientation[1:])


def _of_contact(rod: Rod, load: _Load, before: int, start: int, stop: int) -> ClampWork:
    """Of the rows [start, stop), which are free since the row `before`."""
    reactions, trail = load.reactions, load.reactions.trail
    size = max(1, (stop - start) // _BLOCKS)
    count = (stop - start) // size

    def blocks(rows: Float[np.ndarray, "m *k"]) -> Float[np.ndarray, "count size *k"]:
        return rows[: size * count].reshape(count, size, *rows.shape[1:])

    force, moment = (
        blocks(part[start:]).mean(axis=1) for part in (reactions.force, reactions.moment)
    )
    middle = start + np.arange(count) * size + size // 2
    rows = Sample(force, moment, trail.position[middle], trail.orientation[middle])
    energy = np.nan_to_num(exact_contacts(setting_of(rod, reactions), rows).energy)
    # From well before the first row that stands out of the noise: the load began there.
    begin = max(before, start - (stop - start) // _EARLIER)
    way, turn = _moved(reactions)
    force, moment = (part[1:] + part[:-1] for part in (reactions.force, reactions.moment))
    steps = np.append(0.0, 0.5 * np.sum(force * way + moment * turn, axis=1))
    work = np.cumsum(steps[begin:stop])[start - begin :]
    mean = blocks(work).mean(axis=1)
    largest = float(energy.max()) or _TINY
    deviation = _deviation(reactions, slice(begin, stop), start) / largest
    # Of a smooth course second differences are next to nothing.
    scatter = scipy.stats.median_abs_deviation(np.diff(energy, 2), scale="normal") / math.sqrt(6)
    loading = slice(0, max(2, int(np.argmax(energy >= _LOADING * largest)) + 1))
    # Single blocks in which the inverse goes astray count for nothing.
    lost = median_filter(mean - energy, 3, mode="nearest")
    return ClampWork(
        row=load.rows[middle].astype(float),
        work=mean,
        energy=energy,
        ratio=float(
            mean[loading] @ energy[loading] / max(energy[loading] @ energy[loading], _TINY)
        ),
        ratio_deviation=deviation / _LOADING,
        gained=float(np.max(np.maximum.accumulate(np.maximum(lost, 0.0)) - lost)) / largest,
        remainder=float(work[-1]) / largest if stop < len(load.rows) else math.nan,
        deviation=deviation,
        energy_deviation=float(np.hypot(scatter / largest, _by_setup(reactions))),
    )


def _by_setup(reactions: Reactions) -> float:
    """Standard deviation of work over energy by what the setup says of stiffness and gains."""
    if reactions.setup_errors is None:
        return 0.0
    variance = dict(zip(PARAMETERS, np.diag(reactions.setup_errors.covariance), strict=True))
    gain = max(variance[name] for name in PARAMETERS if name.startswith("gain"))
    return float(np.sqrt(variance["bending_stiffness"] + _BY_GAIN**2 * gain))


def _deviation(reactions: Reactions, rows: slice, free: int) -> float:
    """Of the work [J] by the noise of the samples, and by a tare that is known from the free rows
    before the contact at best to their mean.
    """
    if reactions.covariance is None:
        return 0.0
    first = np.broadcast_to(reactions.covariance, (len(reactions.force), 6, 6))[rows.start]
    variance = np.diag(first).reshape(2, 3).mean(axis=1)
    moved = slice(rows.start, rows.stop - 1)
    squares = np.array([np.sum(part[moved] ** 2) for part in _moved(reactions)])
    by_tare = np.square(_farthest(reactions, rows)) / max(1, free)
    return float(np.sqrt(variance @ (squares + 4 * by_tare)))
