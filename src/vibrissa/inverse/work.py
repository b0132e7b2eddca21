"""The clamp's work on the rod against the rod's bending energy: a consistency check of the numbers.

A rod that starts free takes up the work W = ∫ f0·dx + m0·dω of its clamp. Whatever is not bending
energy U has been lost, by friction or in a snap, and losses never come back: W − U starts at zero
and does not fall. U follows from each wrench by itself (mechanics.md, "The uniform rod in closed
form"), W from wrenches and clamp motion: mistaken units, signs or axes drive the two apart.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float
from scipy.ndimage import median_filter
from scipy.special import chdtri

from vibrissa.geometry.rotation import rotation_vectors
from vibrissa.inverse.arrays import Codes, Flags, Frames, Scalars, Vectors
from vibrissa.inverse.checks.findings import length_text
from vibrissa.inverse.kernels import Sample, candidates_of, exact_contacts
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import setting_of, squares, under_friction
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import PARAMETERS

_FALSE_ALARM = 1e-9
"""Of a free row to count as loaded: fewer than one in any recording."""
_LEAST_LOAD = 0.02
"""The same without stated noise, as a fraction of the largest force."""
_BLOCKS, _FEWEST = 64, 24
"""Block means over a contact, which follow its course, and the fewest rows that make a contact."""
_FREE_ROWS = 3
"""Consecutive ones that separate two contacts; noise hides a weak load for fewer."""
_LARGEST_GAP = 0.02
"""Fraction of a contact's rows that may be missing."""
_EARLIER, _PARTED = 4, 0.1
"""Part of a contact's duration that is looked at before it (a quarter), and the share of loaded
rows there above which it is the rest of another: some are loaded where a load leaves the noise.
"""
_LOADING = 0.9
"""Of the largest energy: where the first loading ends."""
_LEAST_WAY, _SHARE_OF_BEND = 0.01, 0.1
"""Clamp travel: relative to the rod's length, below which a rod stores next to nothing; and to the
tip's deflection, below which the clamp hardly moves.
"""
_CLEARLY_MOVES = 10.0
"""Times the noise of a position: the farthest of ten thousand is four from its true place, and so
may the first be.
"""
_GAINED, _DEVIATIONS = 0.05, 6.0
"""Sound recordings, also with friction and snaps, show at most 0.02 from their noise and the
averaging over rows. An EI 5 % off shows as much; the checks of the sweep are finer.
"""
_MOST_BY_FRICTION = 4.0
"""Sliding with a coefficient of 0.75 takes no more than the rod stores during its first loading."""
_BY_GAIN = 4.0
"""Energy goes with the square of the torques, and with the bent length that they imply: 2 % too
much torque changes it by 7.6 %.
"""
_TINY = 1e-300
_NEAR = (0.9, 1.2)
"""Friction raises the ratio; EI and gains shift it."""
_KNOWN_RATIOS = {
    1e2: "positions in centimetres, taken for metres?",
    1e3: "positions in millimetres, taken for metres, or forces and torques a thousand times too "
    "small?",
    1e-3: "forces and torques in mN and N mm, or positions a thousand times too small?",
    39.370: "positions in inches, taken for metres?",
    9.80665: "forces and torques in kgf and kgf m, taken for N and N m, or EI ten times too large?",
    4.4482: "forces and torques in lbf, taken for N, or EI four times too large?",
    16.0: "the rod's diameter, taken for its radius?",
    -1.0: "the other sign of the wrench, or a sensor turned by half a turn?",
}
_ELSE = (
    "check the units, the order of the quaternions, sign and axes of the wrench, the gain, EI and "
    "length of the rod, the clamp's place and orientation, and the tare"
)


@dataclass(frozen=True, eq=False)
class ClampWork:
    """Work of the clamp and bending energy over one contact, in order (k,), each the mean of a
    few rows.

    Attributes
    ----------
    work, energy
        [J]; the work is zero where the contact begins, and the energy includes that of a support
        that yields.
    ratio, ratio_deviation
        Work over energy during the first loading, up to nine tenths of the largest energy, and its
        standard deviation, as below: 1 without friction, more with it.
    gained
        Largest fall of W − U as a fraction of the largest energy: energy from nowhere. Zero except
        for noise, also with friction and snaps.
    remainder
        Work at the end as a fraction of the largest energy: zero without friction and snaps. NaN if
        the contact does not end.
    deviation
        Standard deviation of `gained` and `remainder` from the noise, as far as it enters the work.
    energy_deviation
        Relative standard deviation of the energies from the noise, and from the stated
        tolerances of stiffness and gains.
    """

    work: Scalars
    energy: Scalars
    ratio: float
    ratio_deviation: float
    gained: float
    remainder: float
    deviation: float
    energy_deviation: float

    @property
    def impossible(self) -> bool:
        """Whether no single contact on this rod can explain it, with any coefficient of friction up
        to 0.75.
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
        """Root mean square of W − U as a fraction of the largest energy; 0 if nothing is lost."""
        return float(np.sqrt(np.mean((self.work - self.energy) ** 2)) / self.energy.max())


@dataclass(frozen=True, eq=False)
class _Load:
    """Finite rows, and the stretches of them under load."""

    rows: Codes
    reactions: Reactions
    loaded: Flags
    spans: list[tuple[int, int]]
    """[start, stop) of contacts that last long enough, split where the rod is free for
    several consecutive rows.
    """

    @cached_property
    def work(self) -> Scalars:
        """Done by the clamp since the previous row."""
        return np.append(0.0, self.reactions.clamp_work)

    def farthest(self, start: int, stop: int) -> Float[np.ndarray, "2"]:
        """How far the clamp moves from its first position, and by how much it turns."""
        trail = self.reactions.trail[start:stop]
        first = np.broadcast_to(trail.orientation[0], trail.orientation.shape)
        moved = trail.position - trail.position[0], rotation_vectors(first, trail.orientation)
        return np.linalg.norm(moved, axis=2).max(axis=1)

    def way(self, rod: Rod, span: tuple[int, int]) -> float:
        """How far the clamp moves, plus the tip through its rotation."""
        return float(self.farthest(*span) @ [1.0, rod.length])


def clamp_work(rod: Rod, reactions: Reactions) -> list[ClampWork]:
    """Work and energy of each contact of one trail that begins with the rod free and lasts long
    enough to be judged; rows are in order, time stamps are not needed. None for a rod with loads
    along it, whose work is not seen in the reactions, or where more than one contact explains them.

    Raises
    ------
    ValueError
        If the reactions are of several trails.
    """
    if reactions.force.ndim != 2:
        raise ValueError(f"reactions of shape {reactions.force.shape}: allowed is one trail (n, …)")
    if rod.loads is not None:
        return []
    load = _load(reactions)
    found, before = list[ClampWork](), 0
    for start, stop in load.spans:
        # Noise may split a weak contact, and for its second part the earlier work is unknown.
        earlier = load.loaded[max(0, start - (stop - start) // _EARLIER) : start]
        begins = start > 0 and np.mean(earlier) < _PARTED
        missing = load.rows[stop - 1] - load.rows[start] + 1 - (stop - start)
        # If the clamp stands still, it is the object that moves and does work.
        moves = load.way(rod, (start, stop)) > _LEAST_WAY * rod.length
        if begins and missing <= _LARGEST_GAP * (stop - start) and moves:
            work = _of_contact(rod, load, before, start, stop)
            found += [] if work is None else [work]
        before = stop
    return found


def work_warnings(found: Reconstruction) -> tuple[list[str], bool, bool]:
    """Lines on clamp work and travel that contradict the reactions, whether no contact can be
    trusted, and whether the work is off by so much that small errors of the setup are no cause;
    empty for sound sweeps, also with friction.

    One line for work that no contact explains, with the likeliest mistake if its ratio to the rod's
    energy matches a known one. One where the rod is loaded and released while its clamp hardly
    moves: if it stands still the object may be moving; if it moves a little the poses are misread.

    Parameters
    ----------
    found
        Contacts of a recording. Without time stamps or noise, with only a few rows, or with loads
        along the rod, there are no lines: `clamp_work` gives the figures.
    """
    if found.reactions.time is None or found.reactions.covariance is None:
        return [], False, False
    # Loads bend the rod while its clamp turns on the spot.
    if found.rod.loads is not None:
        return [], False, False
    told = {line: how for trail in found.trails for line, *how in _told(trail.rod, trail.reactions)}
    untrusted, gross = (any(how[kind] for how in told.values()) for kind in (0, 1))
    return list(told), untrusted, gross


def _told(rod: Rod, reactions: Reactions) -> Iterator[tuple[str, bool, bool]]:
    wrong = [work for work in clamp_work(rod, reactions) if work.impossible]
    if wrong:
        worst = max(wrong, key=lambda work: work.energy.max())
        text = (
            f"the clamp's work is {worst.ratio:.3g} times the rod's bending energy while it is "
            f"loaded (1 without friction, up to {_MOST_BY_FRICTION:g} with it)"
        )
        if worst.gains:
            share = f"{worst.gained:.0%} of the largest energy come"
            text += f", and {share if worst.gained < 1 else 'energy comes'} from nowhere"
        low, high = _NEAR
        known = (
            words for ratio, words in _KNOWN_RATIOS.items() if low < worst.ratio / ratio < high
        )
        gross = not 1 / _MOST_BY_FRICTION < worst.ratio < _MOST_BY_FRICTION
        yield f"{text}: {next(known, _ELSE)}", True, gross
    load = _load(reactions)
    contacts = [span for span in load.spans if span[0] > 0]
    ways = [load.way(rod, span) for span in contacts]
    # How far a force deflects the rod's tip at first; the clamp has to move about as far.
    force = np.linalg.norm(load.reactions.force, axis=1)
    bends = [force[slice(*span)].max() * rod.length / (3 * rod.force_scale) for span in contacts]
    if ways and np.all(np.array(ways) <= _SHARE_OF_BEND * np.array(bends)):
        variance = reactions.position_covariance
        noise = 0.0 if variance is None else float(np.sqrt(np.trace(variance)))
        moves = max(ways) > _CLEARLY_MOVES * noise and max(ways) > 0
        causes = (
            "positions in m, taken for mm?"
            if moves
            else "a pose stream that stands still? It is right only if the object moves"
        )
        size = length_text(max(ways), rod)
        yield (
            f"the clamp moves by no more than {size} while the rod is loaded and released: "
            f"{causes}",
            moves,
            moves,
        )


def _load(reactions: Reactions) -> _Load:
    rows = np.flatnonzero(np.isfinite(reactions.force + reactions.moment).all(axis=1))
    if not rows.size:
        return _Load(rows, reactions, rows > 0, [])
    given = reactions if rows.size == len(reactions.force) else reactions[rows]
    if given.covariance is None:
        size = np.linalg.norm(given.force, axis=1)
        loaded = size > _LEAST_LOAD * size.max()
    else:
        weight = np.linalg.inv(given.covariance[..., :3, :3])
        square = np.einsum("...i,...ij,...j", given.force, weight, given.force)
        loaded = square > chdtri(3, _FALSE_ALARM)
    places = np.flatnonzero(loaded)
    runs = np.split(places, np.flatnonzero(np.diff(places) > _FREE_ROWS) + 1)
    spans = [(int(run[0]), int(run[-1]) + 1) for run in runs if len(run)]
    return _Load(rows, given, loaded, [one for one in spans if one[1] - one[0] >= _FEWEST])


def _of_contact(rod: Rod, load: _Load, before: int, start: int, stop: int) -> ClampWork | None:
    """For the rows [start, stop), free since the row `before`; None if their energy is open."""
    reactions = load.reactions
    size = max(1, (stop - start) // _BLOCKS)
    count = (stop - start) // size

    def means(rows: Float[np.ndarray, "m *k"]) -> Float[np.ndarray, "count *k"]:
        return rows[: size * count].reshape(count, size, *rows.shape[1:]).mean(axis=1)

    middle = start + np.arange(count) * size + size // 2
    force, moment = (means(part[start:]) for part in (reactions.force, reactions.moment))
    trail = reactions.trail[middle]
    rows = Sample(force, moment, trail.position, trail.orientation)
    setting = under_friction(setting_of(rod, reactions), None)
    if setting.rod.candidates > 1:
        noise = reactions.covariance
        if noise is not None:
            noise = np.broadcast_to(noise / squares(rod), (len(load.rows), 6, 6))[middle]
            rows = rows._replace(covariance=noise)
        seen: Any = candidates_of(setting, rows)
        if np.any(np.sum(seen[1], axis=1) > 1):
            return None
    energy = np.nan_to_num(exact_contacts(setting, rows).energy)
    if rod.support is not None:
        turn = trail.rotation
        wrench = np.concatenate([_in_axes(turn, force), _in_axes(turn, moment)], axis=1)
        compliance = np.asarray(rod.support.compliance)
        energy = energy + np.einsum("ni,ij,nj->n", wrench, compliance, wrench) / 2
    # Start well before the first row that stands out of the noise: the load began there.
    begin = max(before, start - (stop - start) // _EARLIER)
    work = np.cumsum(load.work[begin:stop])[start - begin :]
    mean = means(work)
    largest = float(energy.max()) or _TINY
    deviation = _deviation(load, begin, start, stop) / largest
    # Second differences of a smooth course are next to nothing.
    scatter = scipy.stats.median_abs_deviation(np.diff(energy, 2), scale="normal") / math.sqrt(6)
    loading = slice(0, max(2, int(np.argmax(energy >= _LOADING * largest)) + 1))
    stored = energy[loading]
    # Single blocks in which the inverse goes astray do not count.
    lost = median_filter(mean - energy, 3, mode="nearest")
    return ClampWork(
        work=mean,
        energy=energy,
        ratio=float(mean[loading] @ stored / max(stored @ stored, _TINY)),
        ratio_deviation=deviation / _LOADING,
        gained=float(np.max(np.maximum.accumulate(np.maximum(lost, 0.0)) - lost)) / largest,
        remainder=float(work[-1]) / largest if stop < len(load.rows) else math.nan,
        deviation=deviation,
        energy_deviation=float(np.hypot(scatter / largest, _by_setup(reactions))),
    )


def _in_axes(turn: Frames, vectors: Vectors) -> Vectors:
    """Vectors (n, 3) of the world in other axes, given as columns."""
    return np.asarray(np.einsum("nij,ni->nj", turn, vectors))


def _by_setup(reactions: Reactions) -> float:
    """Standard deviation of work over energy from the stated errors of stiffness and gains."""
    if reactions.setup_errors is None:
        return 0.0
    variance = dict(zip(PARAMETERS, np.diag(reactions.setup_errors.covariance), strict=True))
    gain = max(variance[name] for name in PARAMETERS if name.startswith("gain"))
    return float(np.sqrt(variance["bending_stiffness"] + _BY_GAIN**2 * gain))


def _deviation(load: _Load, begin: int, start: int, stop: int) -> float:
    """Of the work [J] from the noise of the samples, and from a tare known at best to the mean of
    the free rows before the contact.
    """
    if load.reactions.covariance is None:
        return 0.0
    first = np.broadcast_to(load.reactions.covariance, (len(load.rows), 6, 6))[begin]
    variance = np.diag(first).reshape(2, 3).mean(axis=1)
    steps = load.reactions.trail[begin:stop].steps.reshape(-1, 2, 3)
    squares = np.sum(steps**2, axis=(0, 2))
    by_tare = load.farthest(begin, stop) ** 2 / max(1, start)
    return float(np.sqrt(variance @ (squares + 4 * by_tare)))
