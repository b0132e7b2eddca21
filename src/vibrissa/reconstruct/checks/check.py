"""Whether a sweep's contacts agree with the setup: the entry points."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label, uniform_filter1d
from scipy.special import chdtri

from vibrissa.contacts import RecordingWarning, Status
from vibrissa.reconstruct.checks.case import (
    GROSS,
    Case,
    Solution,
    case_of,
    phases_by,
    solved,
    spread_along,
    tolerances_of,
    tolerated,
    weighed,
)
from vibrissa.reconstruct.checks.constraints import TANGENT, TIP, Constraints
from vibrissa.reconstruct.checks.passes import contradicts, delay_of, shift_by
from vibrissa.reconstruct.checks.regression import Misfit, fitted, shifts
from vibrissa.reconstruct.checks.rig import frame_of
from vibrissa.reconstruct.checks.stretches import stretches_of
from vibrissa.reconstruct.checks.suspects import SUSPECTS, TELLING, Suspect
from vibrissa.reconstruct.checks.wording import delay_told, named, observed
from vibrissa.reconstruct.result import Reconstruction, trail_of
from vibrissa.reconstruct.work import still_warnings, work_warnings

_LEAST = 20.0
"""Of χ² that a cause has to explain: four and a half standard deviations, of some thirty causes that are tried; sound recordings show 3.6 at most."""
_WITH_FRICTION = 100.0
"""The same where friction leaves open what s₁ and k² should be: what then remains is told less safely."""
_PRICE = 6.0
"""Of χ² for each further number that a cause may choose (BIC for some four hundred rows)."""
_MATTERS = 1e-3
"""Shift of the contacts [L], in a fifth of the sweep, below which a cause does not matter: 50 µm on 50 mm, as smoothed error bars have it."""
_ALIKE, _ALIKE_BY = 0.05, 10.0
"""Causes are named beside the best that explain less by at most this share of it, and this of χ²."""
_FURTHER = 0.1
"""Share of what the first cause explained that a further one has to explain: less may be what is not linear in the first."""
_MOST = 3
_SHOWN = 4
_GROSS = 0.15
"""Size of the best cause, in standard deviations before the data, from which causes are solved for: EI off by more than 5 %."""
_HOPELESS = 0.5
"""Share of what the best explains, below which a cause need not be solved for."""
_POOR = 3.0
"""χ² a row above which a solution is sought from the other side, too."""
_OUTSIDE = 0.05
"""Probability outside of the ellipsoids."""
_NEARLY_ALL = 0.75
"""Share of the misfit beyond noise that a cause explains which is real: 0.8 and more of single causes that were measured, half of a second contact."""
_MOST_APART = 0.3
"""Share of the stretches that may be set apart: what concerns more of them is no exception."""
_WINDOW, _GROSSLY, _SURELY, _PERHAPS = 3, 50.0, 12.0, 6.0
"""Stretches together, and means of their three squares, of which noise makes 3 ± 1.4: from which a part contradicts the rest, where no cause is found (swinging
makes 15) and where one is, and to which it then extends."""


@dataclass(frozen=True)
class Cause:
    """What one cause of error would have to be to explain a sweep's misfit.

    Attributes
    ----------
    name, unit
        Such as `bending_stiffness`, relative ("1").
    estimate, deviation
        One number or several: what is true less what is stated, and its standard deviation.
    significance
        Of the misfit that it explains, in standard deviations.
    explained
        Share of the misfit that it explains.
    shift
        Median shift of the contacts that it implies, in units of the rod.
    """

    name: str
    unit: str
    estimate: tuple[float, ...]
    deviation: tuple[float, ...]
    significance: float
    explained: float
    shift: float


@dataclass(frozen=True, eq=False)
class SetupCheck:
    """What a sweep says of its setup.

    Attributes
    ----------
    causes
        Each cause by itself, those that explain most first. They are candidates: several explain the same.
    reduced_chi_square
        Mean square of what the constraints leave, in that of noise; 1 where all is as stated.
    friction
        Coefficient that tangential contacts show if all else is as stated, or the one given.
    named
        Names of causes that explain about as much as each other, one tuple a warning.
    warnings
        One line each.
    shift
        (…, 3) by how far contacts are off if the likeliest causes are right, of those named together the largest; units of the rod, world axes; 0 where none is named.
    misread
        Whether the numbers contradict each other as a whole, as with other units, signs or axes, so that no contact is to be trusted.
    apart
        (…) rows that belong to no single contact while all others agree with the setup, as where the rod touches two places; None where there are none.
    """

    causes: tuple[Cause, ...]
    reduced_chi_square: float
    friction: float
    named: tuple[tuple[str, ...], ...]
    warnings: tuple[str, ...]
    shift: Float[np.ndarray, "*trail n 3"]
    misread: bool = False
    apart: Bool[np.ndarray, "*trail n"] | None = None


def check_setup(found: Reconstruction) -> SetupCheck:
    """What the contacts of a recording say of rod, clamp and sensor, with no object known.

    Parameters
    ----------
    found
        Contacts of one sweep (n, …) or several (m, n, …), sample by sample or smoothed; the reactions tell, not the smoothed contacts.

    Returns
    -------
    SetupCheck
        Empty where the noise is not known, or too little of the sweep is in contact.

    Notes
    -----
    Each contact obeys more conditions than it has unknowns (`vibrissa.reconstruct.checks.constraints`). What is left of them is explained by one cause at a time, by
    generalised least squares under the noise, the error of the zero, a model error of 2e-4 L and errors that the setup tolerates (mechanics.md, "What the data say of
    the setup").
    """
    shift = np.zeros_like(found.point)
    if found.reactions.covariance is None or found.reactions.time is None:
        return SetupCheck((), 1.0, found.friction or 0.0, (), (), shift)
    if found.kind.ndim == 1:
        return _of_trail(found, shift)
    parts = [_of_trail(trail_of(found, j), shift[j]) for j in range(len(found.kind))]
    worst = max(parts, key=lambda part: part.causes[0].significance if part.causes else 0.0)
    lines = [f"trail {j}: {line}" for j, part in enumerate(parts) for line in part.warnings]
    apart = [np.zeros(found.kind.shape[1], dtype=bool) if part.apart is None else part.apart for part in parts]
    return replace(
        worst, warnings=tuple(lines), shift=np.stack([part.shift for part in parts]), apart=np.stack(apart) if np.any(apart) else None
    )


def checked(found: Reconstruction) -> Reconstruction:
    """The same contacts with what they say against the setup: `setup_check`, `warnings` (each also a `RecordingWarning`), and statuses as by `with_contradictions`."""
    said = check_setup(found)
    trails = [found] if found.kind.ndim == 1 else [trail_of(found, j) for j in range(len(found.kind))]
    by_work = list(dict.fromkeys(line for trail in trails for line in work_warnings(trail))) if found.reactions.time is not None else []
    still, moves = still_warnings(trails[0]) if len(trails) == 1 and found.reactions.time is not None else ([], False)
    lines = [*said.warnings, *by_work, *still]
    for line in lines:
        warnings.warn(line, RecordingWarning, stacklevel=3)
    said = replace(said, misread=bool(said.misread or by_work or moves or found.reactions.misread))
    return with_contradictions(with_delay(replace(found, setup_check=said, warnings=[*found.warnings, *lines])))


def with_delay(found: Reconstruction) -> Reconstruction:
    """The same contacts of one trail, with a delay of the poses among the causes where passes to and fro tell one that is not named yet."""
    said = found.setup_check
    if said is None or said.misread or any(_DELAY in names for names in said.named):
        return found
    delay = delay_of(found)
    if delay is None or not contradicts(delay, found):
        return found
    line = delay_told(delay.seconds, delay.deviation, delay.shift, found.rod.unit_of("length"))
    warnings.warn(line, RecordingWarning, stacklevel=4)
    cause = Cause(_DELAY, "s", (delay.seconds,), (delay.deviation,), abs(delay.seconds) / delay.deviation, float("nan"), delay.shift)
    own = np.nan_to_num(shift_by(delay, found))
    larger = np.linalg.norm(own, axis=1, keepdims=True) > np.linalg.norm(said.shift, axis=1, keepdims=True)
    said = replace(
        said,
        causes=(cause, *said.causes),
        named=(*said.named, (_DELAY,)),
        warnings=(*said.warnings, line),
        shift=np.where(larger, own, said.shift),
    )
    return replace(found, setup_check=said, warnings=[*found.warnings, line])


_DELAY = "pose_delay"


def with_contradictions(found: Reconstruction) -> Reconstruction:
    """`SETUP_CONTRADICTED` on rows that the likeliest causes of the check move out of their 95 % ellipsoid, where nothing else is found against them."""
    said = found.setup_check
    if said is None or not (said.warnings or said.misread) or found.covariance is None:
        return found
    status = found.status
    if said.apart is not None:
        status = np.where(said.apart & found.in_contact & (status == Status.OK), Status.TOUCHES_TWICE, status)
    open_to = np.isin(status, (Status.OK, Status.SETUP_CONTRADICTED))
    judged = open_to & found.in_contact & np.isfinite(found.covariance).all(axis=(-1, -2))
    covariance = np.where(judged[..., None, None], found.covariance, np.eye(3))
    distance = np.einsum("...i,...i->...", said.shift, np.linalg.solve(covariance, said.shift[..., None])[..., 0])
    told = np.where(judged & (said.misread | (distance > chdtri(3, _OUTSIDE))), Status.SETUP_CONTRADICTED, Status.OK)
    return replace(found, status=np.where(open_to, told, status).astype(np.int8))


class _Tried(NamedTuple):
    """One cause, as large as explains most."""

    score: float
    """What it explains of χ², less a price for its numbers."""
    suspect: Suspect
    size: Float[np.ndarray, "p"]
    deviation: Float[np.ndarray, "p"]
    explained: float
    moved: Float[np.ndarray, "k 3"]
    """Shift of the contacts that it implies, clamp axes [L]."""

    @property
    def shift(self) -> float:
        """In the median."""
        return float(np.median(np.linalg.norm(self.moved, axis=1)))

    @property
    def largest(self) -> float:
        """Where it is largest, in a fifth of the sweep: a length shows, and matters, in tip contact alone."""
        return float(np.quantile(np.linalg.norm(self.moved, axis=1), 0.8))


# Readings that no rod has make numbers without bound; what is not finite is left out.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _of_trail(found: Reconstruction, shift: Float[np.ndarray, "n 3"]) -> SetupCheck:
    nothing = SetupCheck((), 1.0, found.friction or 0.0, (), (), shift)
    averaged = stretches_of(found)
    case = None if averaged is None else case_of(averaged, frame_of(found.reactions, found.rod.length), found.friction)
    return nothing if case is None else _of_case(found, case, shift)


def _of_case(found: Reconstruction, case: Case, shift: Float[np.ndarray, "n 3"]) -> SetupCheck:
    tip = phases_by(case, [suspect.directions for suspect in SUSPECTS[:TELLING]])
    misfit, friction = weighed(case, tip, tolerated(case, found.reactions, found.rod.length))
    first = _tried(case, tip, misfit)
    matters = _matters(_alike(first), _WITH_FRICTION if case.silent.any() else 0.0) and not _tolerable(found, case)
    apart = _apart(misfit, first[0] if matters else None)
    if apart is not None:
        rest = case_of(case.bench.stretches.chosen(~apart), case.bench.frame, found.friction)
        if rest is not None and not _of_case(found, rest, shift).warnings:
            rows = _rows_of(case, apart, len(found.kind))
            line = _told_apart(found, misfit, rows)
            return replace(_concluded(found, case, misfit, friction, first, [], []), warnings=(line,), apart=rows)
    if not matters:
        return _concluded(found, case, misfit, friction, first, [], [])
    best = next((one for one in _alike(first) if one.suspect in SUSPECTS[:TELLING]), None)
    if best is not None and float(np.max(np.abs(best.size) / spread_along(case, best.suspect.directions))) > _GROSS:
        first = _nonlinear(found, case, tip, misfit, first)
    groups: list[list[_Tried]] = []
    lines: list[str] = []
    about = case
    tried = first
    while len(groups) < _MOST and _matters(_alike(tried), _FURTHER * first[0].score):
        groups.append(_alike(tried))
        lines.append(_line(found, about, tip, groups[-1]))
        errors = about.errors + np.clip(tried[0].suspect.directions @ tried[0].size, -GROSS * case.spread, GROSS * case.spread)
        about = about.about(errors, found.friction)
        tip = phases_by(about, [suspect.directions for suspect in SUSPECTS[:TELLING]], started=False)
        tried = _tried(about, tip, weighed(about, tip, tolerated(about, found.reactions, found.rod.length))[0])
    concluded = _concluded(found, case, misfit, friction, first, groups, lines)
    return concluded if lines else replace(concluded, warnings=(_unexplained(found, case, tip, misfit),), misread=True)


def _tolerable(found: Reconstruction, case: Case) -> bool:
    """Whether errors of the sizes that the setup states explain it after all: solved for, as they are not linear."""
    stated = tolerances_of(case, found.reactions, found.rod.length)
    spread = np.linalg.norm(stated, axis=0)
    # A delay shows in no single contact.
    directions, spread = stated[:, spread > 0] / spread[spread > 0], spread[spread > 0]
    if not spread.size:
        return False
    size = solved([case], directions, spread, found.friction, np.zeros_like(spread)).size
    if np.max(np.abs(size) / spread) >= GROSS:
        return False
    about = case.about(directions @ size, found.friction)
    tip = phases_by(about, [directions])
    tried = _tried(about, tip, weighed(about, tip, tolerated(about, found.reactions, found.rod.length))[0])
    return not _matters(_alike(tried), _WITH_FRICTION if case.silent.any() else 0.0)


def _apart(misfit: Misfit, best: _Tried | None) -> Bool[np.ndarray, "k"] | None:
    """Stretches of one part of the sweep that alone contradict the rest; None where there is no such part, or the best cause, if any, explains nearly all."""
    rows = len(misfit.value)
    excess = float(misfit.value @ misfit.value) - rows
    if best is not None and (excess < rows or best.explained > _NEARLY_ALL * excess):
        return None
    square = uniform_filter1d(np.sum(misfit.alone**2, axis=1), _WINDOW, mode="nearest")
    runs, _ = label(square > _PERHAPS)
    sure = np.unique(runs[square > (_GROSSLY if best is None else _SURELY)])
    apart = np.isin(runs, sure[sure > 0])
    return apart if 0 < np.mean(apart) < _MOST_APART else None


def _rows_of(case: Case, chosen: Bool[np.ndarray, "k"], count: int) -> Bool[np.ndarray, "n"]:
    """Samples of stretches, and those between neighbours."""
    rows = np.zeros(count, dtype=bool)
    runs, found = label(chosen)
    for run in range(1, found + 1):
        own = np.flatnonzero(runs == run)
        rows[case.bench.stretches.first[own[0]] : case.bench.stretches.last[own[-1]]] = True
    return rows


def _told_apart(found: Reconstruction, misfit: Misfit, rows: Bool[np.ndarray, "n"]) -> str:
    time = found.reactions.time
    assert time is not None
    runs, count = label(rows)
    spans = [np.flatnonzero(runs == run) for run in range(1, count + 1)]
    when = " and ".join(f"from {time[own[0]]:.4g} to {time[own[-1]]:.4g} s" for own in spans)
    return (
        f"{when} force and moment are those of no single contact, by up to {np.abs(misfit.alone).max():.0f} standard deviations, while the rest agrees with the "
        "setup: the rod touches two places there, or its tip is caught"
    )


def _alike(tried: list[_Tried]) -> list[_Tried]:
    """The best, and those that explain about as much."""
    best = tried[0].score
    return [one for one in tried if one.score >= best * (1 - _ALIKE) - _ALIKE_BY]


def _matters(together: list[_Tried], least: float) -> bool:
    return bool(together) and together[0].score >= max(_LEAST, least) and max(one.largest for one in together) >= _MATTERS


def _tried(case: Case, tip: Bool[np.ndarray, "k"], misfit: Misfit) -> list[_Tried]:
    """All causes beside friction, the best first."""
    rub = misfit.whitened(case.friction)
    by_friction = fitted(misfit, rub, case.friction_spread).explained if rub.shape[1] else 0.0
    moves = shifts(case.slopes, case.stretches.noise, case.here, tip)
    found = []
    for suspect in SUSPECTS:
        count = suspect.directions.shape[1]
        design = np.concatenate([misfit.whitened(case.slopes.constraints @ suspect.directions), rub], axis=1)
        both = fitted(misfit, design, np.concatenate([spread_along(case, suspect.directions), case.friction_spread]))
        size, explained = both.size[:count], both.explained - by_friction
        deviation = np.sqrt(np.diag(both.covariance)[:count])
        found.append(_Tried(explained - _PRICE * (count - 1), suspect, size, deviation, explained, moves @ (suspect.directions @ size)))
    return sorted(found, key=lambda one: -one.score)


def _nonlinear(found: Reconstruction, case: Case, tip: Bool[np.ndarray, "k"], misfit: Misfit, first: list[_Tried]) -> list[_Tried]:
    """Causes that are gross: solved for, those that the linear fit finds hopeless left out."""
    none = float(misfit.value @ misfit.value)
    own = shifts(case.slopes, case.stretches.noise, case.here, tip)
    chosen = [one for one in first if one.suspect in SUSPECTS[:TELLING] and one.score > _HOPELESS * first[0].score]
    out = []
    for one in chosen:
        directions = one.suspect.directions
        spread = spread_along(case, directions)
        start = np.clip(one.size, -spread, spread)
        best = solved([case], directions, spread, found.friction, start)
        if len(spread) == 1 and _left(best, spread) > _POOR * len(misfit.value):
            best = min(best, solved([case], directions, spread, found.friction, -start), key=lambda solution: _left(solution, spread))
        explained = none - _left(best, spread)
        moved = own @ (directions @ best.size)
        out.append(
            _Tried(explained - _PRICE * (len(spread) - 1), one.suspect, best.size, np.sqrt(np.diag(best.covariance)), explained, moved)
        )
    return sorted(out, key=lambda one: -one.score) or first


def _left(solution: Solution, spread: Float[np.ndarray, "p"]) -> float:
    misfit = solution.misfits[0]
    return float(misfit.value @ misfit.value + np.sum((solution.size / spread) ** 2))


def _concluded(
    found: Reconstruction, case: Case, misfit: Misfit, friction: float, first: list[_Tried], groups: list[list[_Tried]], lines: list[str]
) -> SetupCheck:
    square, rows = float(misfit.value @ misfit.value), len(misfit.value)
    return SetupCheck(
        tuple(_cause(found, one, max(square - rows, 1.0)) for one in first),
        square / rows,
        friction,
        tuple(tuple(one.suspect.name for one in group) for group in groups),
        tuple(lines),
        _shift_of_rows(found, case, groups),
    )


def _cause(found: Reconstruction, one: _Tried, total: float) -> Cause:
    unit, factor = _unit(found, one.suspect.name)
    return Cause(
        one.suspect.name,
        unit,
        tuple(map(float, factor * one.size)),
        tuple(map(float, factor * one.deviation)),
        float(np.sqrt(max(one.explained, 0.0))),
        float(np.clip(one.explained / total, 0.0, 1.0)),
        one.shift * found.rod.length,
    )


def _unit(found: Reconstruction, name: str) -> tuple[str, float]:
    """Unit of a cause's numbers, and what takes them there from model units."""
    rod = found.rod
    si = rod.units == "SI"
    match name.split("_", maxsplit=1)[0]:
        case "length" | "clamp" if name != "clamp_orientation":
            return rod.unit_of("length"), rod.length
        case "clamp":
            return "rad", 1.0
        case "rest":
            return rod.unit_of("curvature"), 1 / rod.length
        case "load":
            return "N/m" if si else "1", rod.force_scale / rod.length
        case "drift" | "zero":
            force = name[-2] == "f"
            unit = rod.unit_of("force" if force else "moment")
            return unit + ("/s" if name.startswith("drift") else ""), rod.force_scale if force else rod.moment_scale
    return "1", 1.0


def _line(found: Reconstruction, case: Case, tip: Bool[np.ndarray, "k"], together: Sequence[_Tried]) -> str:
    best, here, rod = together[0], case.here, found.rod
    signal = np.abs(case.slopes.constraints @ (best.suspect.directions @ best.size)) / case.deviations
    signal[~tip, TIP], signal[tip, TANGENT] = 0.0, 0.0
    seen = _seen(found, here, tip, int(np.argmax(np.sum(signal**2, axis=0))))
    order = sorted(together, key=lambda one: SUSPECTS.index(one.suspect))[:_SHOWN]
    causes = [
        named(one.suspect.name, tuple(_unit(found, one.suspect.name)[1] * one.size), rod.length, rod.unit_of("length")) for one in order
    ]
    shift, place = max(one.shift for one in together), "in the median"
    if shift < _MATTERS:
        shift, place = max(one.largest for one in together), "in a fifth of the sweep"
    moved = f"{1e3 * shift * rod.length:.2g} mm" if rod.units == "SI" else f"{shift:.2g} L"
    return f"{seen}, {np.sqrt(best.explained):.0f} standard deviations: likely {', or '.join(causes)}; contacts are then off by {moved} {place}"


def _unexplained(found: Reconstruction, case: Case, tip: Bool[np.ndarray, "k"], misfit: Misfit) -> str:
    value = np.take_along_axis(np.abs(case.here.value) / case.deviations, misfit.pick, axis=1) * misfit.told.reshape(-1, 3)
    stretch, column = np.unravel_index(np.argmax(value), value.shape)
    seen = _seen(found, case.here, tip, int(misfit.pick[stretch, column]))
    deviations = np.sqrt(float(misfit.value @ misfit.value))
    return (
        f"{seen}, {deviations:.0f} standard deviations: no single cause explains it; check the units, signs and axes of wrench and poses, "
        "the sensor's calibration, and the rod's length and stiffness"
    )


def _seen(found: Reconstruction, here: Constraints, tip: Bool[np.ndarray, "k"], row: int) -> str:
    of_row = tip if row == TIP else ~tip if row == TANGENT else np.ones_like(tip)
    size = here.value[of_row, row] / (here.steepness[of_row] if row == TIP else 1.0)
    return observed(row, float(np.median(size)), found.rod.length, found.rod.unit_of("length"))


def _shift_of_rows(found: Reconstruction, case: Case, groups: Sequence[Sequence[_Tried]]) -> Float[np.ndarray, "n 3"]:
    """World axes and units of the rod: of each group the largest, all together."""
    stretches = case.bench.stretches
    total = np.zeros((len(stretches.time), 3))
    for group in groups:
        each = np.stack([one.moved for one in group])
        largest = np.argmax(np.linalg.norm(each, axis=2), axis=0)
        total += each[largest, np.arange(len(total))]
    world = np.einsum("kij,kj->ki", stretches.turn, total) * found.rod.length
    assert found.reactions.time is not None
    return np.stack([np.interp(found.reactions.time, stretches.time, world[:, axis]) for axis in range(3)], axis=1)
