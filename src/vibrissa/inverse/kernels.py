"""Contacts sample by sample: what a wrench says about its contact, what noise and the setup's
tolerances imply, and whether the row can be trusted.

All in model units, except as stated in `Setting` and `Found`; vectors are in world axes.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind, Status
from vibrissa.inverse.arrays import Flag, Scalar, Spread, Vector, Wrench
from vibrissa.inverse.inverse import single_contact, towards
from vibrissa.inverse.parameters import Rig, changes
from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.model import Clamp, Contact, Resting, RodModel
from vibrissa.numerics.lanes import FEW, AnyArray, lanes
from vibrissa.numerics.linear import cholesky, solve_3x3, solve_lower
from vibrissa.numerics.rotation import cross_matrix, first_axis, rotation_matrix, third_axis
from vibrissa.numerics.vectors import joined

SINGLE_CONTACT, TIP, LEAST_FORCE = 1e-3, 1e-6, 1e-14
"""If the noise is unknown: how closely reactions must fit a single contact, and s₁ the rod's length
[L], and the smallest force that counts as contact [EI/L²]: ten times the rounding errors of scans.
"""
LEAST_LOADED = 1e-9
"""The same for a rod that other loads bend: ten times the rounding errors of their resultants."""
_RESOLVED = TIP
"""Largest estimated error of the discretisation [L]: kinds and places are right to as much."""
_SINGLE_DEVIATIONS, _TIP_DEVIATIONS, _STEEP_DEVIATIONS, _KIND_DEVIATIONS = 6.0, 5.0, 3.0, 2.0
"""If the noise is known, in standard deviations: largest violation of m0·f0 = 0; up to where s₁ > L
is noise and the tip is imposed; from where a tangent is too steep; within which a contact counts as
one at the tip.
"""
_TIP_STEPS = 10
_SETTLED = 1e-15
"""Relative change of the wrench that ends the steps to the tip: rounding."""
_FIRST_ORDER = 20.0
"""Standard deviations of the force above which first-order errors hold nine times in ten or more
(measured, `benchmarks/signal_strength.py`); below, second moments are used.
"""
_CHANGE, _BEFORE = 1e-7, 1e-6
"""Change of a wrench, as a fraction, by which contacts are differentiated where not exactly; and of
a force, by which they move farther than by that.
"""
_TINY = 1e-300


class Setting(NamedTuple):
    """What all samples share, in units of the rod."""

    length: float
    force: float
    moment: float
    steepest: float
    """Largest incidence that friction explains."""
    threshold: float
    """χ² of the wrench above which a sample counts as contact."""
    rig: Rig | None = None
    errors: Float[AnyArray, "setup setup"] | None = None
    """Covariance of the setup errors, model units."""
    rod: RodModel = Elastica()
    leaning: float = math.inf
    """Largest cosine between force and rod in a contact before the tip."""


class Sample(NamedTuple):
    """Reactions of one row, in units of the rod."""

    force: Vector
    moment: Vector
    position: Vector
    orientation: Float[AnyArray, "4"]
    covariance: Spread | None = None
    """Of the wrench, model units."""
    velocity: Wrench | None = None
    """Of the clamp: clamp axes, rod lengths and radians per second."""
    resting: Resting | None = None
    """The rod without contact, where distributed loads bend it."""


Row = Float[AnyArray, "*n"]
Points = Float[AnyArray, "*n 3"]
Matrices = Float[AnyArray, "*n 3 3"]


class Errors(NamedTuple):
    """Covariances of point and force direction."""

    point: Matrices
    direction: Matrices


class Found(NamedTuple):
    """Contact of one row, in units of the rod; NaN without contact. Fields are those of
    `Reconstruction` except the last four.
    """

    kind: Int[AnyArray, "*n"]
    status: Int[AnyArray, "*n"]
    point: Points
    force_direction: Points
    arc_length: Row
    energy: Row
    modulus: Row
    single_contact_residual: Row
    arc_length_deviation: Row | None = None
    chi_square: Row | None = None
    noise: Errors | None = None
    """From what varies from sample to sample."""
    setup: Errors | None = None
    """From what all samples share."""
    weak: Bool[AnyArray, "*n"] | None = None
    """Whether it is far from linear in the noise, so that errors need second moments."""
    likely: "Likely | None" = None


class Observed(NamedTuple):
    """What errors are propagated to; or its derivatives, or variances."""

    reach: Float[AnyArray, "3 *p"]
    direction: Float[AnyArray, "3 *p"]
    arc_length: Float[AnyArray, "*p"]
    incidence: Float[AnyArray, "*p"]
    single: Float[AnyArray, "*p"]
    """m0·f0, in standard deviations."""


class _Reader(NamedTuple):
    """What a wrench at the clamp says about its contact, under given loads."""

    rod: RodModel
    clamp: Clamp
    load: Any = None
    """What the loads contribute to the reactions (6,), if there are any."""
    which: Int[Any, ""] | int = 0
    """Which of several contacts is meant, in order along the rod."""

    def contact(self, wrench: Wrench) -> Contact:
        """The contact that explains a wrench of its own."""
        whole = wrench if self.load is None else wrench + self.load
        return self.rod.contact(whole[:3], whole[3:], self.clamp, self.which)


class _Held(NamedTuple):
    """A rod at its clamp, and its reactions without those of distributed loads."""

    reader: _Reader
    wrench: Wrench
    """Of the contact alone."""
    push: Wrench
    """How the reactions differ from those of the free rod."""
    tip: Vector
    """Of the free rod, seen from the clamp [L]."""
    measured: Contact
    """What the wrench itself says."""
    several: Flag | bool = False
    """Whether others explain the reactions too."""
    unlikely: Flag | bool = False
    """Whether none explains them, if they are exact."""
    sound: Flag | bool = True
    """Whether the free rod has a stable shape."""


class _Read(NamedTuple):
    """The contact that explains a wrench, with derivatives with respect to that wrench."""

    contact: Contact
    slopes: Observed
    """That of m0·f0 is of what the contact itself does to the clamp [(EI)²/L³]."""
    couple: Scalar
    """m0·f0 of what the contact itself does to the clamp."""
    load: Float[Array, "6 6"] | None
    """Derivatives of what the loads contribute to the reactions, if there are any."""


class Likely(NamedTuple):
    """Most probable wrench of a single contact within the rod's length, one row per sample."""

    wrench: Float[AnyArray, "*n 6"]
    reach: Points
    direction: Points
    at_tip: Float[AnyArray, "*n 6"]
    """Most probable wrench of a force at the tip of a hardly bent rod."""
    off_tip: Row
    """Its distance, in standard deviations."""
    which: Int[AnyArray, "*n"]
    """Which of several contacts is meant, in order along the rod."""
    load: Any = None
    """What the loads contribute to the reactions (n, 6), if there are any."""


class _Probable(NamedTuple):
    """The same for one sample, with what errors and status need."""

    held: _Held
    likely: Likely
    contact: Contact
    single: Scalar
    slopes: Observed
    """With respect to the measured wrench; those of s₁ and incidence as if the tip were not
    imposed.
    """
    pinned: Flag
    """Whether the wrench was moved to the tip."""


def _exact(setting: Setting, sample: Sample) -> Found:
    """Contact of exact reactions."""
    held = _held(setting, sample)
    force, moment = held.wrench[:3], held.wrench[3:]
    contact = held.measured
    f, m = jnp.sqrt(jnp.sum(force * force)), jnp.sqrt(jnp.sum(moment * moment))
    push = jnp.sqrt(jnp.sum(held.push[:3] ** 2))
    touching = jnp.where(push > 0, push > LEAST_FORCE, jnp.sum(held.push[3:] ** 2) > 0)
    if setting.rod.loaded:
        touching = push > LEAST_LOADED
    single, none = jnp.dot(force, moment) / (f * m), jnp.zeros(())
    return _judged(setting, sample, contact, touching, held, single, SINGLE_CONTACT, none, none)


exact_contacts = lanes(alone=FEW, by_call=True)(_exact)
many_exact_contacts = lanes(width=128, blocks=128)(_exact)
"""The same for tens of thousands of rows, in larger calls."""


@lanes(alone=FEW, by_call=True, walks=True)
def noisy_contacts(setting: Setting, sample: Sample) -> Found:
    """Contact of the most probable single-contact wrench on this rod, with first-order errors."""
    probable = _probable(setting, sample)
    covariance = jnp.asarray(sample.covariance)
    whitened = solve_lower(cholesky(covariance), probable.held.push)
    chi_square = jnp.sum(whitened**2)
    noise = whole = _carried(probable.slopes, covariance)
    setup = None
    if setting.errors is not None:
        setup = _carried(_by_setup(probable, sample, setting.rig), setting.errors)
        whole = jax.tree.map(jnp.add, noise, setup)
    deviation = jnp.sqrt(whole.arc_length)
    found = _judged(
        setting,
        sample,
        probable.contact,
        chi_square > setting.threshold,
        probable.held,
        probable.single / jnp.sqrt(whole.single),
        _SINGLE_DEVIATIONS,
        deviation,
        jnp.sqrt(whole.incidence),
    )
    scale = jnp.where(found.kind == ContactKind.NONE, jnp.nan, setting.length)
    of_noise, of_setup = (
        None if part is None else Errors(part.reach * scale**2, part.direction + 0 * scale)
        for part in (noise, setup)
    )
    variance = jnp.trace(covariance[:3, :3]) / 3
    return found._replace(
        noise=of_noise,
        setup=of_setup,
        arc_length_deviation=deviation * scale,
        chi_square=chi_square,
        weak=(jnp.sum(probable.likely.wrench[:3] ** 2) <= _FIRST_ORDER**2 * variance)
        | (noise.arc_length > setting.rod.linear**2),
        likely=probable.likely,
    )


@lanes(alone=FEW, by_call=True, walks=True)
def weak_contacts(setting: Setting, sample: Sample, likely: Likely) -> Errors:
    """Errors of the same contact by second moments: mean squared errors of r and n̂ under noise,
    from points √6 deviations to either side along each axis of its ellipsoid.

    They match the noise's mean and covariance, and two more moments along each axis (S. J. Julier,
    J. K. Uhlmann, Proc. IEEE 92 (2004) 401-422): if the force is only a few deviations, or the rod
    is thin at the contact, that is far from linear in them.
    """
    reader = _Reader(setting.rod, _clamp_of(setting, sample), likely.load, likely.which)
    covariance = jnp.asarray(sample.covariance)
    # In clamp axes, so that the points turn with the clamp.
    both = jnp.kron(jnp.eye(2), rotation_matrix(sample.orientation))
    root = _product(both, cholesky(_product(_product(both.T, covariance), both)))
    steps = math.sqrt(6) * jnp.concatenate([root.T, -root.T])

    def seen(wrench: Wrench) -> tuple[Vector, Vector]:
        wrench, _ = single_contact(wrench, covariance)
        found, force = reader.contact(wrench), wrench[:3]
        # A line of action that the rod does not meet passes behind the clamp.
        met = jnp.isfinite(found.arc_length)
        reach = jnp.where(met, found.reach, 0.0)
        along = -force / jnp.sqrt(jnp.sum(force * force))
        return _within_reach(reach), jnp.where(met, found.direction, along)

    reach, direction = lax.map(
        seen, jnp.concatenate([likely.wrench + steps, likely.at_tip + steps])
    )
    reach = reach - likely.reach
    # Perpendicular to n̂: a unit vector can only turn.
    along = jnp.sum(direction * likely.direction, axis=1, keepdims=True)
    direction = direction - along * likely.direction
    # A contact that looks tangential may be one at the tip, as likely as noise makes one look like
    # the other.
    odds = jnp.append(1.0, jnp.exp(-(likely.off_tip**2) / 2))
    weights = (odds / (jnp.sum(odds) * len(steps))).repeat(len(steps))
    of_reach, of_direction = (_product(part.T * weights, part) for part in (reach, direction))
    return Errors(of_reach * setting.length**2, of_direction)


@lanes(alone=FEW, by_call=True, walks=True)
def sensitivities_of(setting: Setting, sample: Sample) -> Observed:
    """Derivatives of a contact with respect to `vibrissa.tolerances.PARAMETERS`, for given
    readings.
    """
    return _by_setup(_probable(setting, sample), sample, setting.rig)


def _held(setting: Setting, sample: Sample) -> _Held:
    """Of several contacts that may be the true one, the first."""
    wrench = jnp.concatenate([sample.force / setting.force, sample.moment / setting.moment])
    rod, clamp = setting.rod, _clamp_of(setting, sample)
    free = rod.free(clamp, sample.resting)
    tip = free.at(jnp.ones(()))[0] - clamp.point
    which, several = jnp.zeros((), dtype=int), jnp.zeros((), dtype=bool)
    unlikely = several
    found = candidates_at(setting, sample)
    if rod.candidates > 1:
        fits = _explain(setting, sample, found)
        which, several = jnp.argmax(fits), jnp.sum(fits) > 1
        unlikely = ~jnp.any(fits) if sample.covariance is None else unlikely
    measured = jax.tree.map(lambda part: part[which], found)
    if not rod.loaded:
        reader = _Reader(rod, clamp, None, which)
        return _Held(reader, wrench, wrench, tip, measured, several, unlikely)
    load = measured.load
    load = jnp.where(jnp.all(jnp.isfinite(load)), load, free.reactions)
    apart, reader = (wrench - load, wrench - free.reactions), _Reader(rod, clamp, load, which)
    return _Held(reader, *apart, tip, measured, several, unlikely, free.sound)


def candidates_at(setting: Setting, sample: Sample) -> Contact:
    """All contacts (k,) at which the reactions leave no moment in the rod, in order along it; an
    arc length of NaN if there are fewer.
    """
    wrench = jnp.concatenate([sample.force / setting.force, sample.moment / setting.moment])
    return setting.rod.contacts(wrench[:3], wrench[3:], _clamp_of(setting, sample))


def _clamp_of(setting: Setting, sample: Sample) -> Clamp:
    turn = sample.orientation
    return Clamp(sample.position / setting.length, third_axis(turn), first_axis(turn))


def _explain(setting: Setting, sample: Sample, found: Contact) -> Bool[Array, "k"]:
    """Which contacts may be the true one: on the rod, and pushed as an object with friction can
    push: across the rod, or backwards at its tip.
    """
    off = jnp.asarray(SINGLE_CONTACT)
    if sample.covariance is not None:
        force = jnp.sqrt(jnp.sum((sample.force / setting.force) ** 2))
        variance = jnp.trace(jnp.asarray(sample.covariance))
        off = jnp.maximum(off, _SINGLE_DEVIATIONS * jnp.sqrt(variance) / force)
    return explaining(found, setting.steepest, setting.leaning, jnp.maximum(off, TIP))


def explaining(
    found: Contact, steepest: Scalar | float, leaning: Scalar | float, off: Scalar | float
) -> Bool[Array, "k"]:
    """Which of several contacts an object can have made whose friction bounds incidence and leaning
    as in `Setting`; places and gaps [L] may be off by so much.
    """
    s = found.arc_length
    across = jnp.abs(2 * found.incidence - 1) < leaning
    pushed = jnp.where(jnp.abs(s - 1) < off, found.incidence < steepest, across)
    # Comparisons with NaN are false. Behind the contact a thin end would be rolled up and cross the
    # force's line time and again.
    known = (found.gap < off) & jnp.isfinite(found.error)
    again = jnp.any(jnp.tril(jnp.abs(s[:, None] - s) < TIP, -1), axis=1)
    return pushed & known & ~again & (s < 1 + off)


@lanes(alone=FEW, by_call=True)
def candidates_of(setting: Setting, sample: Sample) -> tuple[Contact, Bool[Array, "k"]]:
    """All contacts (k,) with no moment in the rod, and which of them may be the true one."""
    found = candidates_at(setting, sample)
    return found, _explain(setting, sample, found)


@lanes(alone=FEW, by_call=True, walks=True)
def deviations_of_candidates(setting: Setting, sample: Sample) -> Float[Array, "k"]:
    """Standard deviations of the arc lengths (k,) of `candidates_of` [L], for known noise."""
    wrench = jnp.concatenate([sample.force / setting.force, sample.moment / setting.moment])
    clamp, covariance = _clamp_of(setting, sample), jnp.asarray(sample.covariance)

    def arc_lengths(wrench: Wrench) -> Float[Array, "k"]:
        found: Array = setting.rod.contacts(wrench[:3], wrench[3:], clamp).arc_length
        return found

    change = _CHANGE * jnp.max(jnp.abs(wrench))
    slopes, _ = setting.rod.derivatives(lambda x: (arc_lengths(x), ()), wrench, change=change)
    return jnp.sqrt(jnp.sum(_product(slopes, covariance) * slopes, axis=1))


def _judged(
    setting: Setting,
    sample: Sample,
    contact: Contact,
    touching: Flag,
    held: _Held,
    single: Scalar,
    most: float,
    deviation: Scalar,
    steepness: Scalar,
) -> Found:
    """Kind, status and units; `deviation` and `steepness` are those of s₁ and incidence."""
    s1, incidence = contact.arc_length, contact.incidence
    bad = ~jnp.all(jnp.isfinite(jnp.concatenate([sample.force, sample.moment])))
    couple = touching & jnp.all(sample.force == 0) & jnp.any(sample.moment != 0)
    unsolved = touching & ~jnp.isfinite(s1)
    unknown = bad | couple | unsolved
    none = unknown | ~touching
    # Friction does not push a rod back along itself either, except at its tip. That tells the
    # contacts of a curved rod apart; a straight one that touches twice is still nearly right.
    curved = jnp.asarray(setting.rod.candidates > 1)
    before_tip = s1 < 1 - TIP - _TIP_DEVIATIONS * deviation
    backwards = incidence + _STEEP_DEVIATIONS * steepness < 1 - setting.steepest
    # The most serious finding wins.
    findings = (
        (bad, Status.BAD_DATA),
        (~jnp.asarray(held.sound), Status.FALLS_OVER),
        (couple, Status.NOT_SINGLE_CONTACT),
        (unsolved, Status.NO_CURVATURE_ZERO),
        (none, Status.OK),
        (jnp.asarray(held.several) & (jnp.abs(single) <= most), Status.NOT_UNIQUE),
        (jnp.asarray(contact.error) > _RESOLVED, Status.NOT_CONVERGED),
        (incidence >= 1, Status.NO_CURVATURE_ZERO),
        (incidence - _STEEP_DEVIATIONS * steepness > setting.steepest, Status.STEEP_TANGENT),
        (before_tip & backwards & curved, Status.STEEP_TANGENT),
        (s1 > 1 + TIP + _TIP_DEVIATIONS * deviation, Status.BEYOND_TIP),
        ((jnp.abs(single) > most) | held.unlikely, Status.NOT_SINGLE_CONTACT),
    )
    conditions, codes = zip(*findings, strict=True)
    tip = s1 > 1 - TIP - _KIND_DEVIATIONS * deviation
    kind = jnp.where(
        none, ContactKind.NONE, jnp.where(tip, ContactKind.TIP, ContactKind.TANGENTIAL)
    )
    unit = jnp.where(none, jnp.nan, 1.0)
    return Found(
        kind=kind.astype(jnp.int8),
        status=jnp.select(conditions, codes, Status.OK).astype(jnp.int8),
        point=sample.position + contact.reach * (unit * setting.length),
        force_direction=contact.direction * unit,
        arc_length=s1 * (unit * setting.length),
        energy=jnp.where(unknown, jnp.nan, jnp.where(none, 0.0, contact.energy * setting.moment)),
        modulus=incidence * unit,
        single_contact_residual=single,
    )


def _probable(setting: Setting, sample: Sample) -> _Probable:
    held, covariance = _held(setting, sample), jnp.asarray(sample.covariance)
    measured = held.wrench
    single, deviation = single_contact(measured, covariance)
    straight, off_straight = _unbent_tip(single, held.tip, covariance)
    wrench, read = _within_the_rod(single, straight, off_straight, held, covariance)
    contact = read.contact._replace(reach=_within_reach(read.contact.reach))
    # Errors pass through the projection onto a single contact, but not through the limit at the
    # tip, which would cut them off.
    across = jnp.roll(wrench, 3)
    spread = covariance @ across
    onto = spread / jnp.sum(across * spread)
    if read.load is not None:
        # They are taken off before.
        across = across - across @ read.load
    slopes = jax.tree.map(
        lambda slope: slope - jnp.sum(slope * onto, axis=-1, keepdims=True) * across, read.slopes
    )
    couple = jnp.roll(measured, 3)
    return _Probable(
        held,
        Likely(
            wrench,
            contact.reach,
            contact.direction,
            straight,
            off_straight,
            jnp.asarray(held.reader.which),
            held.reader.load,
        ),
        contact,
        deviation,
        slopes._replace(single=couple / jnp.sqrt(couple @ covariance @ couple)),
        # By more than rounding, which puts contacts right at the tip on either side of it.
        jnp.max(jnp.abs(wrench - single)) > _RESOLVED * jnp.max(jnp.abs(wrench)),
    )


def _read(held: _Held, wrench: Wrench) -> _Read:
    """What a wrench says about its contact, and how that changes with it."""

    def seen(wrench: Wrench) -> tuple[tuple[Observed, Wrench | None], Contact]:
        contact, alone = held.reader.contact(wrench), wrench
        if held.reader.load is not None:
            # What the loads do there depends on how the rod is bent.
            alone = wrench + held.reader.load - contact.load
        couple = jnp.sum(alone[:3] * alone[3:])
        return (Observed(*contact[:4], couple), contact.load), contact

    # Derivatives differ on the two sides of a loaded rod's tip; a larger force acts before it.
    about = joined((1 + _BEFORE) * wrench[:3], wrench[3:]) if held.reader.rod.loaded else None
    (slopes, by_load), ((observed, _), contact) = held.reader.rod.derivatives(
        seen, wrench, change=_CHANGE * jnp.max(jnp.abs(wrench)), about=about
    )
    return _Read(contact, slopes, observed.single, by_load)


def _carried(slopes: Observed, covariance: Float[AnyArray, "p p"]) -> Observed:
    """Covariances of the observed quantities."""

    def of(slope: Float[Array, "*k p"]) -> Float[Array, "..."]:
        half = _product(slope, covariance)
        return jnp.sum(half * slope) if slope.ndim == 1 else _product(half, slope.T)

    return jax.tree.map(of, slopes)


def _within_reach(reach: Vector) -> Vector:
    """No contact is farther from the clamp than the rod is long; near first contact noise may put
    it there.
    """
    return reach / jnp.maximum(jnp.sqrt(jnp.sum(reach * reach)), 1.0)


def _by_setup(probable: _Probable, sample: Sample, rig: Rig | None) -> Observed:
    """With other setup parameters the same readings are another wrench on another rod, seen from
    another place: derivatives with respect to these parameters.
    """
    slopes, contact, turn = probable.slopes, probable.contact, rotation_matrix(sample.orientation)
    wrench = probable.likely.wrench
    force, moment, reach, direction = (
        part @ turn for part in (wrench[:3], wrench[3:], contact.reach, contact.direction)
    )
    wrench = jnp.concatenate([force, moment])
    by = changes(rig, wrench, reach, direction, jnp.asarray(sample.velocity))
    seen = jnp.concatenate([_product(turn, by.wrench[:3]), _product(turn, by.wrench[3:])])
    # A wrench that was moved to the tip stays there, whatever the setup's parameters.
    longer, spread = slopes.arc_length, jnp.asarray(sample.covariance) @ slopes.arc_length
    along = spread / jnp.maximum(longer @ spread, _TINY) * probable.pinned
    held = seen - jnp.outer(along, _product(longer, seen))
    moved = jax.tree.map(lambda slope: -_product(slope, seen), slopes)
    return moved._replace(
        reach=_product(turn, by.reach) - _product(slopes.reach, held),
        direction=_product(turn, by.direction) - _product(slopes.direction, held),
    )


def _product(first: Float[AnyArray, "*k l"], second: Float[AnyArray, "l m"]) -> Float[Array, "..."]:
    """Matrix product in plain arithmetic, which keeps the lanes together."""
    return jnp.sum(jnp.asarray(first)[..., None] * second, axis=-2)


class _Sought(NamedTuple):
    """On the way to the most probable wrench: where to look next, and what was seen before."""

    wrench: Wrench
    read: _Read
    """Of the wrench before."""
    steps: Int[Array, ""]
    beyond: Flag
    """Whether the measured contact is beyond the tip."""
    before: Scalar
    """What the condition of a single contact alone changes, as in `_meeting`."""
    last: Flag
    """Whether this wrench is the one."""
    done: Flag


def _within_the_rod(
    wrench: Wrench,
    straight: Wrench,
    off_straight: Scalar,
    held: _Held,
    covariance: Spread,
) -> tuple[Wrench, _Read]:
    """The most probable wrench of a single contact with s₁ ≤ L, and what it says: a contact beyond
    the tip by no more than noise explains is one at the tip.
    """
    plain = isinstance(held.reader.rod, Elastica)
    given = wrench if plain else held.wrench

    def step(sought: _Sought) -> _Sought:
        at, first = sought.wrench, sought.steps == 0
        read = _read(held, at)
        # Of the logarithm of s₁, and of a single contact. A plain rod stays one of a single contact
        # when moved to its tip.
        s1, count = read.contact.arc_length, 1 if plain else 2
        values = jnp.stack([jnp.log(s1), read.couple])[:count]
        slopes = jnp.stack([read.slopes.arc_length / s1, read.slopes.single])[:count]
        beyond = jnp.where(first, values[0] > 0, sought.beyond)
        moved, square, of_couple = _meeting(given, at, values, slopes, covariance)
        # From beyond the tip: at the tip the couple's slope depends on the side.
        before = jnp.where(first, of_couple, sought.before)
        settled = jnp.max(jnp.abs(moved - at)) <= _SETTLED * jnp.max(jnp.abs(wrench))
        stops = ~beyond | settled | (sought.steps + 1 >= _TIP_STEPS)
        near = (jnp.abs(values[0]) < TIP) & (square - before < _TIP_DEVIATIONS**2)
        chosen = jnp.where(off_straight < _TIP_DEVIATIONS, straight, wrench)
        chosen = jnp.where(near, jnp.where(settled, at, moved), chosen)
        chosen = jnp.where(beyond, chosen, at)
        done = sought.last | (stops & jnp.all(chosen == at))
        onward = jnp.where(stops, chosen, moved)
        return _Sought(
            jnp.where(sought.last, at, onward),
            read,
            sought.steps + 1,
            beyond,
            before,
            stops,
            done,
        )

    none, no = jnp.zeros(()), jnp.zeros((), dtype=bool)
    blank = jax.tree.map(
        lambda part: jnp.zeros(part.shape, part.dtype), jax.eval_shape(_read, held, wrench)
    )
    start = _Sought(wrench, blank, jnp.zeros((), dtype=int), no, none, no, no)
    found: _Sought = lax.while_loop(lambda sought: ~sought.done, step, start)
    return found.wrench, found.read


def _meeting(
    start: Wrench,
    at: Wrench,
    values: Float[Array, "k"],
    slopes: Float[Array, "k 6"],
    covariance: Spread,
) -> tuple[Wrench, Scalar, Scalar]:
    """A step as in `towards`, under one or two conditions; the square of the change in standard
    deviations, and of the change that the second condition alone asks for.
    """
    if len(values) == 1:
        moved, deviations = towards(start, at, values[0], slopes[0], covariance)
        return moved, deviations**2, jnp.zeros(())
    spread = _product(covariance, slopes.T)
    (a, b), (_, c) = _product(slopes, spread)
    x, y = values + jnp.sum(slopes * (start - at), axis=1)
    # The inverse of a matrix of two rows, by hand: it keeps the lanes together.
    p, q = (c * x - b * y) / (a * c - b * b), (a * y - b * x) / (a * c - b * b)
    return start - spread[:, 0] * p - spread[:, 1] * q, x * p + y * q, y * y / c


def _unbent_tip(wrench: Wrench, tip: Vector, covariance: Spread) -> tuple[Wrench, Scalar]:
    """Most probable wrench of a force at the tip of a still unbent rod, and its distance in
    standard deviations.

    Near first contact noise may move s₁ by rod lengths, and the bent rod's equations are no help.
    """
    # f0 = −F and m0 = −r × F, so m0 = r × f0.
    design = jnp.concatenate([jnp.eye(3), cross_matrix(tip)])
    root = cholesky(covariance)
    weighted = jax.vmap(solve_lower, (None, 1), 1)(root, design)
    seen = solve_lower(root, wrench)
    best = solve_3x3(_product(weighted.T, weighted), weighted.T @ seen)
    off = seen - weighted @ best
    return design @ best, jnp.sqrt(jnp.sum(off * off))
