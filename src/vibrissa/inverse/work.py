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

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import chdtri
from scipy.stats import median_abs_deviation

from vibrissa.geometry.rotation import rotation_vectors
from vibrissa.inverse.kernels import Sample, exact_contacts
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import setting_of
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import PARAMETERS

_FALSE_ALARM = 1e-9
# Without stated noise: of the largest force.
_LEAST_LOAD = 0.02
_BLOCKS = 64
_FEWEST_BLOCKS = 24
_FREE_ROWS = 3
_LARGEST_GAP = 0.02
_EARLIER = 4
# Share of the rows just before: where a load rises out of the noise some are loaded, too.
_PARTED = 0.1
_LOADING = 0.9
# Of the rod's length: a rod bent by less of a way stores next to nothing.
_LEAST_WAY = 0.01
_SHARE_OF_BEND = 0.1
# Of the noise of a position: the farthest of ten thousand is four from where it is, and so is the
# first.
_CLEARLY_MOVES = 10.0
_MEDIAN = 3
# Sound recordings, also with friction and snaps: at most 0.02 by their noise and the mean over
# rows. EI 5 % off is as much; the checks of the sweep are finer.
_GAINED = 0.05
_DEVIATIONS = 6.0
# Sliding with a coefficient of 0.75 takes no more than the rod takes up while it is loaded first.
_MOST_BY_FRICTION = 4.0
# Energy goes with the torques' square, and with the length that they say is bent: 2 % too much
# torque is 7.6 % of it.
_BY_GAIN = 4.0
# Friction raises the ratio, EI and gains move it.
_NEAR = (0.9, 1.2)
_KNOWN_RATIOS = (
    (1e2, "positions in centimetres, taken for metres?"),
    (
        1e3,
        "positions in millimetres, taken for metres, or forces and torques a thousand times too "
        "small?",
    ),
    (1e-3, "forces and torques in mN and N mm, or positions a thousand times too small?"),
    (39.370, "positions in inches, taken for metres?"),
    (9.80665, "forces and torques in kgf and kgf m, taken for N and N m?"),
    (4.4482, "forces and torques in lbf, taken for N?"),
    (16.0, "the rod's diameter, taken for its radius?"),
    (-1.0, "the other sign of the wrench, or a sensor turned by half a turn?"),
)
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
        ratio = math.hypot(self.ratio_deviation, self.energy_deviation)
        return self.gains or self.ratio > _MOST_BY_FRICTION + _DEVIATIONS * ratio

    @property
    def gains(self) -> bool:
        """Whether energy comes from nowhere."""
        deviation = math.hypot(self.deviation, self.energy_deviation)
        return self.gained > _GAINED + _DEVIATIONS * deviation

    @property
    def misfit(self) -> float:
        """Root mean square of W − U as a share of the largest energy, 0 where nothing is lost."""
        return float(np.sqrt(np.mean((self.work - self.energy) ** 2)) / self.energy.max())


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
    known, loaded, contacts = _contacts(reactions)
    if not contacts:
        return []
    steps = _steps(reactions, known)
    before = [0, *(stop for _, stop in contacts)]
    return [
        _of_contact(rod, reactions, known, steps, (first, start, stop))
        for first, (start, stop) in zip(before, contacts, strict=False)
        if start > 0
        and _free_before(loaded, (start, stop))
        and _whole(known, (start, stop))
        # Where the clamp stands, it is the object that moves, and works.
        and _way(rod, reactions, known[start:stop]) > _LEAST_WAY * rod.length
    ]


def work_warnings(found: Reconstruction) -> list[str]:
    """One line on clamp work that no contact explains, with the likeliest mistake where the ratio
    is that of a known one; empty for sound sweeps, also with friction.

    Parameters
    ----------
    found
        Contacts of a recording. Of reactions without stamps or noise, or of a few rows, nothing is
        said: `clamp_work` gives the figures.
    """
    worst = max(
        (work for work in clamp_work(found.rod, found.reactions) if work.impossible),
        key=lambda work: work.energy.max(),
        default=None,
    )
    return [] if worst is None else [_told(worst)]


def still_warnings(found: Reconstruction) -> tuple[list[str], bool]:
    """One line where the rod is loaded and released while its clamp hardly moves, and whether it
    moves at all.

    Where it stands the object may move; where it moves a little the poses are misread.
    """
    rod, reactions = found.rod, found.reactions
    if reactions.covariance is None:
        return [], False
    known, _, spans = _contacts(reactions)
    contacts = [known[start:stop] for start, stop in spans if start > 0]
    ways = [_way(rod, reactions, rows) for rows in contacts]
    # By so much a force bends the rod's tip at first; the clamp has to go about as far.
    bent = [
        float(np.linalg.norm(reactions.force[rows], axis=1).max())
        * rod.length
        / (3 * rod.force_scale)
        for rows in contacts
    ]
    if not ways or any(
        way > _SHARE_OF_BEND * deflection for way, deflection in zip(ways, bent, strict=True)
    ):
        return [], False
    noise = (
        0.0
        if reactions.position_covariance is None
        else float(np.sqrt(np.trace(reactions.position_covariance)))
    )
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


def _told(work: ClampWork) -> str:
    text = (
        f"the clamp's work is {work.ratio:.3g} times the rod's bending energy while it is loaded "
        f"(1 without friction, up to {_MOST_BY_FRICTION:g} with it)"
    )
    if work.gains:
        text += (
            f", and {work.gained:.0%} of the largest energy come from nowhere"
            if work.gained < 1
            else ", and energy comes from nowhere"
        )
    low, high = _NEAR
    guess = next(
        (words for ratio, words in _KNOWN_RATIOS if low < work.ratio / ratio < high), _ELSE
    )
    return f"{text}: {guess}"


def _loaded(reactions: Reactions, known: np.ndarray) -> Bool[np.ndarray, "m"]:
    force = reactions.force[known]
    if reactions.covariance is None:
        size = np.linalg.norm(force, axis=1)
        return np.asarray(size > _LEAST_LOAD * size.max())
    covariance = np.broadcast_to(reactions.covariance, (len(reactions.force), 6, 6))[known, :3, :3]
    square = np.einsum("ni,ni->n", force, np.linalg.solve(covariance, force[..., None])[..., 0])
    return np.asarray(square > chdtri(3, _FALSE_ALARM))


def _contacts(
    reactions: Reactions,
) -> tuple[Int[np.ndarray, "m"], Bool[np.ndarray, "m"], list[tuple[int, int]]]:
    """Rows that hold numbers, whether each is loaded, and stretches [start, stop) of them that are
    long enough, parted where the rod is free for some rows on end.
    """
    both = np.concatenate([reactions.force, reactions.moment], axis=1)
    known = np.flatnonzero(np.isfinite(both).all(axis=1))
    loaded = _loaded(reactions, known) if len(known) else np.zeros(0, dtype=bool)
    rows = np.flatnonzero(loaded)
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > _FREE_ROWS) + 1)
    spans = [(int(run[0]), int(run[-1]) + 1) for run in runs if run.size]
    return known, loaded, [span for span in spans if span[1] - span[0] >= _FEWEST_BLOCKS]


def _free_before(loaded: Bool[np.ndarray, "m"], span: tuple[int, int]) -> bool:
    """Whether a contact begins there: noise may part a weak one, and of the rest the earlier work
    is not known.
    """
    start, stop = span
    earlier = loaded[max(0, start - (stop - start) // _EARLIER) : start]
    return float(np.mean(earlier)) < _PARTED


def _whole(known: np.ndarray, span: tuple[int, int]) -> bool:
    """Whether next to no rows are missing within a contact."""
    first, last = known[span[0]], known[span[1] - 1]
    return bool(last + 1 - first <= (1 + _LARGEST_GAP) * (span[1] - span[0]))


def _way(rod: Rod, reactions: Reactions, rows: np.ndarray) -> float:
    """How far the clamp goes, and the tip by its turning."""
    far, turned = _farthest(reactions, rows)
    return far + rod.length * turned


def _farthest(reactions: Reactions, rows: np.ndarray) -> tuple[float, float]:
    """How far the clamp goes from where it is at first, and by how much it turns."""
    position, orientation = reactions.trail.position[rows], reactions.trail.orientation[rows]
    turned = rotation_vectors(np.broadcast_to(orientation[0], orientation.shape), orientation)
    moved = (position - position[0], turned)
    far, angle = (float(np.linalg.norm(part, axis=1).max()) for part in moved)
    return far, angle


def _steps(reactions: Reactions, known: np.ndarray) -> Float[np.ndarray, "m"]:
    """Work [J] from each known row to the next, 0 for the first."""
    force, moment = reactions.force[known], reactions.moment[known]
    position, orientation = reactions.trail.position[known], reactions.trail.orientation[known]
    way, turn = np.diff(position, axis=0), rotation_vectors(orientation[:-1], orientation[1:])
    steps = 0.5 * np.sum((force[1:] + force[:-1]) * way + (moment[1:] + moment[:-1]) * turn, axis=1)
    return np.concatenate([[0.0], steps])


def _of_contact(
    rod: Rod,
    reactions: Reactions,
    known: np.ndarray,
    steps: Float[np.ndarray, "m"],
    span: tuple[int, int, int],
) -> ClampWork:
    """Of the rows [start, stop), which are free since the row `before`."""
    before, start, stop = span
    size = max(1, (stop - start) // _BLOCKS)
    count = (stop - start) // size
    inside = known[start : start + size * count].reshape(count, size)
    middle = inside[:, size // 2]
    force, moment = reactions.force[inside].mean(axis=1), reactions.moment[inside].mean(axis=1)
    trail = reactions.trail
    rows = Sample(force, moment, trail.position[middle], trail.orientation[middle])
    energy = np.nan_to_num(exact_contacts(setting_of(rod, reactions), rows).energy)
    # From well before the first row that stands out of the noise: the load began there.
    begin = max(before, start - (stop - start) // _EARLIER)
    work = np.cumsum(steps[begin:stop])[start - begin :]
    mean = work[: size * count].reshape(count, size).mean(axis=1)
    largest = float(energy.max()) or 1e-300
    deviation = _deviation(reactions, known[begin:stop], start) / largest
    energy_deviation = float(np.hypot(_scatter(energy) / largest, _by_setup(reactions)))
    loading = slice(0, max(2, int(np.argmax(energy >= _LOADING * largest)) + 1))
    ratio = float(
        mean[loading] @ energy[loading] / max(float(energy[loading] @ energy[loading]), 1e-300)
    )
    lost = _smoothed(mean - energy)
    gained = float(np.max(np.maximum.accumulate(np.maximum(lost, 0.0)) - lost)) / largest
    remainder = float(work[-1]) / largest if stop < len(known) else float("nan")
    return ClampWork(
        middle.astype(float),
        mean,
        energy,
        ratio,
        deviation / _LOADING,
        gained,
        remainder,
        deviation,
        energy_deviation,
    )


def _by_setup(reactions: Reactions) -> float:
    """Standard deviation of work over energy by what the setup says of stiffness and gains."""
    if reactions.setup_errors is None:
        return 0.0
    variance = dict(zip(PARAMETERS, np.diag(reactions.setup_errors.covariance), strict=True))
    gain = max(variance[name] for name in PARAMETERS if name.startswith("gain"))
    return float(np.sqrt(variance["bending_stiffness"] + _BY_GAIN**2 * gain))


def _scatter(energy: Float[np.ndarray, "k"]) -> float:
    """Standard deviation of the energies by noise, from their second differences: of a smooth
    course they are next to nothing.
    """
    return float(median_abs_deviation(np.diff(energy, 2), scale="normal")) / math.sqrt(6)


def _smoothed(values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
    """Running medians: single blocks in which the inverse goes astray count for nothing."""
    padded = np.pad(values, _MEDIAN // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, _MEDIAN), axis=-1))


def _deviation(reactions: Reactions, rows: np.ndarray, free: int) -> float:
    """Of the work [J] by the noise of the samples, and by a tare that is known from the free rows
    before the contact at best to their mean.
    """
    if reactions.covariance is None:
        return 0.0
    covariance = np.broadcast_to(reactions.covariance, (len(reactions.force), 6, 6))[rows[0]]
    force, moment = (
        float(np.sqrt(np.trace(part) / 3)) for part in (covariance[:3, :3], covariance[3:, 3:])
    )
    position, orientation = reactions.trail.position[rows], reactions.trail.orientation[rows]
    way = np.linalg.norm(np.diff(position, axis=0), axis=1)
    turn = np.linalg.norm(rotation_vectors(orientation[:-1], orientation[1:]), axis=1)
    far, turned = _farthest(reactions, rows)
    by_samples = force**2 * np.sum(way**2) + moment**2 * np.sum(turn**2)
    by_tare = (force**2 * far**2 + moment**2 * turned**2) / max(1, free)
    return float(np.sqrt(by_samples + 4 * by_tare))
