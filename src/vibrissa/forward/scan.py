"""The forward problem's entry point."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from vibrissa.contact import COULOMB, FRICTIONLESS, Law, Scene, Skin
from vibrissa.contacts import ContactKind, Motion, Status
from vibrissa.forward.approach import neutral
from vibrissa.forward.assess import DEPTH_TOLERANCE, Assessment, assess, assessed
from vibrissa.forward.events import Event, Happening
from vibrissa.forward.march import SINGLE, Mode, march_ahead, nowhere
from vibrissa.forward.path import chosen, path_of
from vibrissa.forward.result import Scan
from vibrissa.forward.search import caught
from vibrissa.forward.sweep import Sweep, sweep
from vibrissa.geometry.checks import not_negative
from vibrissa.mechanics.free import at_rest, check_loads
from vibrissa.mechanics.kirchhoff import ACCURACY, steps_for
from vibrissa.mechanics.model import Clamp, Resting
from vibrissa.mechanics.models import model_of
from vibrissa.numerics.lanes import FEW, WIDTH, in_threads, lanes, threads
from vibrissa.numerics.progress import Progress, Tally
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.surfaces import Offset, Surface
from vibrissa.trail import Trail

_TRAILS = 512
"""Most trails that a thread takes at once: enough that the fixed cost of each share matters little,
in some 30 MB of memory.
"""


def scan(
    rod: Rod,
    surface: Surface,
    trail: Trail,
    *,
    friction: float = 0.0,
    finite_radius: bool = False,
    accuracy: float = ACCURACY,
    progress: Progress | None = None,
) -> Scan:
    """Quasi-static equilibria of a rod swept along an object, with a single contact (paper,
    sections II and III).

    Parameters
    ----------
    rod
        Any rod. Reactions are what its support exerts, with its weight and the wind on it.
    surface
        Object; smooth, in units of the rod.
    trail
        Clamp poses (n, …), or several trails (m, n, …), in units of the rod. The sweep follows
        their order.
    friction
        Coulomb friction coefficient between rod and object: 0 for none, as in the paper.
    finite_radius
        Whether contact is with the rod's skin, one radius from the centre line, which rounds off
        edges and corners. By default, as in the paper, the centre line touches, and the object must
        be smooth. With friction the force still acts on the centre line, whose path stands in for
        the skin's: the couple of the force about the centre line and the rotation of the section
        are neglected, both of first order in the radius.
    accuracy
        Error of contacts [L] that decides into how many steps a rod is divided that has no closed
        form; 1e-8 takes six tenths of the steps that 1e-10 takes. Each row's own error is part of
        its residual, and a row beyond 1e-8 is `NOT_CONVERGED`.
    progress
        `progress(done, total)` is called now and then with the steps done and their total.

    Returns
    -------
    Scan
        One row per position. A row that could not be solved, or whose state fails a check, carries
        a status; the other rows keep their results.

    Raises
    ------
    ValueError
        If the clamp is inside the object at every position, the coefficient is negative or not
        finite, `finite_radius` is set for a rod without a radius, the accuracy is not positive, or
        a function of the rod's loads does not return finite numbers.

    Notes
    -----
    The branch from first contact is followed, even where it has become laterally unstable, which
    the status then says. Steps longer than 0.05 L are divided. Where a position has several
    equilibria, the result is the one that the sweep reaches.

    With friction a state depends on its history: the contact sticks, slips or rolls, and the result
    converges as the trail's steps are refined. After a snap, and where a trail begins in contact
    without a smooth way in, the contact starts without tangential force. Stability against leaving
    the bending plane is not assessed with friction.

    Many trails are distributed over the cores (`VIBRISSA_THREADS=1` uses only one).
    """
    friction = not_negative(friction, "friction")
    touched = touched_surface(rod, surface) if finite_radius else surface
    scene = Scene(touched, rod.length, friction, model_of(rod, steps_for(accuracy)))
    law = COULOMB if friction > 0 else FRICTIONLESS
    path = path_of(trail, rod.length)
    count = len(path.point)

    # Kernels that every scan needs are compiled in parallel.
    march_ahead(scene, law, chosen(path.clamps, np.s_[: SINGLE + 1]))
    some = Clamp(*(part.reshape(-1, 3)[: FEW + 1] for part in path.clamps))
    assess.ahead(scene, nowhere(scene, law, len(some.point)).state, some, law)

    # Whole blocks of lanes, and work for every thread.
    share = min(_TRAILS, WIDTH * -(-count // (WIDTH * threads())))
    tally = Tally(progress, path.point[..., 0].size)

    def part(first: int) -> tuple[dict[str, np.ndarray], list[Happening]]:
        own = np.s_[first : first + share]
        some = type(path)(path.point[own], path.orientation[own], path.stride)
        found = sweep(scene, some, law, tally)
        return _fields(rod, scene, law, some.clamps, path.stride, found), found.happenings

    parts = in_threads(part, range(0, count, share))
    fields = {
        name: np.concatenate([fields[name] for fields, _ in parts]).reshape(*trail.shape, *rest)
        for name, rest in ((name, rows.shape[1:]) for name, rows in parts[0][0].items())
    }
    if np.all(fields["status"] == Status.CLAMP_INSIDE):
        outermost = trail.position.reshape(-1, 3)[0].tolist()
        raise ValueError(
            f"trail.position = {outermost} …: the clamp is inside the object; allowed is outside"
        )
    check_loads(rod, trail, fields["status"] == Status.FALLS_OVER)
    happenings = [
        (first * share + at.lane, at) for first, part in enumerate(parts) for at in part[1]
    ]
    return Scan(
        rod,
        surface,
        trail,
        reactions=Reactions(trail, fields.pop("force"), fields.pop("moment")),
        events=_events(happenings, rod, trail, path.stride, touched),
        friction=friction,
        finite_radius=finite_radius,
        offset=touched.radius if isinstance(touched, Offset) else 0.0,
        **fields,
    )


def touched_surface(rod: Rod, surface: Surface) -> Skin:
    """The object as seen by the centre line of the rod."""
    if rod.radius is None:
        raise ValueError("rod.radius = None; allowed with finite_radius is a number greater than 0")
    return Skin(surface, rod.radius)


def _fields(
    rod: Rod, scene: Scene, law: Law, clamps: Clamp, stride: int, found: Sweep
) -> dict[str, np.ndarray]:
    """Fields of `Scan`, with force and moment by name, at all positions of some trails, one trail
    after another: each of shape (trails * positions, …).
    """
    clamps, steps, status = jax.tree.map(
        lambda rows: np.concatenate(rows[:, ::stride]),
        (clamps, found.steps, found.status),
    )
    places, lost = np.flatnonzero(steps.mode == Mode.CONTACT), steps.mode == Mode.LOST
    values, second = assessed(scene, law, *chosen((steps.reached.state, clamps), places))
    offset = scene.surface.radius if isinstance(scene.surface, Offset) else 0.0
    # Where no single contact was found, the tip may be caught between two parts.
    several = len(scene.surface.solids) > 1
    jammed = np.flatnonzero(several & (status == Status.NO_EQUILIBRIUM))
    for place, held in zip(jammed, caught(scene, chosen(clamps, jammed)), strict=True):
        if held is not None:
            own, normal = held
            values = jax.tree.map(lambda rows, row: np.append(rows, [row], axis=0), values, own)
            second = np.append(second, [own.point - offset / scene.length * normal], axis=0)
            places, lost[place], status[place] = np.append(places, place), False, Status.PENETRATING
    figure, friction = steps.figure[places], float(scene.friction)
    skin = np.full(len(places), offset)
    if scene.slims:
        skin = np.asarray(rod.radius_at(values.arc_length))
    worst = _worst(
        rod,
        scene.rod.accuracy,
        friction,
        neutral(scene, chosen(clamps, places), values.direction),
        values,
        figure,
        status[places],
    )
    status[places] = worst
    kind = np.where(values.phase > 0, ContactKind.TANGENTIAL, ContactKind.TIP)

    def spread(rows: np.ndarray, elsewhere: float = np.nan) -> np.ndarray:
        whole = np.full((len(status), *rows.shape[1:]), elsewhere, rows.dtype)
        whole[places] = rows
        return whole

    free = _hanging(scene, clamps, np.flatnonzero(steps.mode == Mode.FREE))

    def known(rows: np.ndarray, hanging: np.ndarray | None = None) -> np.ndarray:
        """A quantity that is zero on a rod that nothing loads, and unknown on unsolved rows."""
        whole = spread(rows, 0.0)
        if hanging is not None:
            whole[free.rows] = hanging
        whole[lost] = np.nan
        return whole

    return {
        "kind": spread(kind.astype(np.int8), ContactKind.NONE),
        "point": spread(values.point * rod.length - skin[:, None] * values.normal),
        "normal": spread(values.normal),
        "force_direction": spread(values.direction),
        "motion": spread(_motion(kind, figure, friction), Motion.NONE),
        "arc_length": spread(values.arc_length * rod.length),
        "force": known(values.support * rod.force_scale, free.force * rod.force_scale),
        "moment": known(values.moment * rod.moment_scale, free.moment * rod.moment_scale),
        "energy": known(values.energy * rod.moment_scale, free.energy * rod.moment_scale),
        "contact_force": known(rod.force_scale * values.force[:, None] * values.direction),
        "largest_curvature": known(values.largest_curvature / rod.length),
        "largest_bend": known(values.largest_bend / rod.length),
        "contact_tangent": spread(values.tangent),
        "plane_normal": spread(values.plane_normal),
        "residual": spread(values.residual),
        "depth": spread(values.depth * rod.length),
        "status": status.astype(np.int8),
        "second_contact": spread(_second_contacts(scene, values, second, worst)),
    }


class _Hanging(NamedTuple):
    """What rods without contact exert, at some rows (k,)."""

    rows: Int[np.ndarray, "k"]
    force: Float[np.ndarray, "k 3"]
    moment: Float[np.ndarray, "k 3"]
    energy: Float[np.ndarray, "k"]


def _hanging(scene: Scene, clamps: Clamp, rows: Int[np.ndarray, "k"]) -> _Hanging:
    if not scene.rod.loaded:
        rows = rows[:0]
    some = chosen(clamps, rows)
    found: Any = _free(scene, some, at_rest(scene.rod, some))
    reactions, energy = found
    return _Hanging(rows, reactions[:, :3], reactions[:, 3:], energy)


@lanes(alone=FEW)
def _free(
    scene: Scene, clamp: Clamp, resting: Resting
) -> tuple[Float[Array, "6"], Float[Array, ""]]:
    """Reactions and energy of the rod without contact."""
    free = scene.rod.free(clamp, resting)
    return free.reactions, free.energy


def _second_contacts(
    scene: Scene, values: Assessment, second: Float[np.ndarray, "k 3"], status: Int[np.ndarray, "k"]
) -> Float[np.ndarray, "k 3"]:
    """Points on the object where rods lie deepest in it, or are caught."""
    wrong = (status == Status.PENETRATING)[:, None]
    places = np.where(wrong, second * scene.length, np.nan)
    entered = (values.depth > DEPTH_TOLERANCE) & np.isfinite(places).all(axis=-1)
    if isinstance(scene.surface, Offset) and entered.any():
        places[entered] = scene.surface.foot(places[entered])
    return places


def _motion(
    kind: Int[np.ndarray, "k"], figure: Float[np.ndarray, "k"], friction: float
) -> Int[np.ndarray, "k"]:
    at_rest = np.where(kind == ContactKind.TANGENTIAL, Motion.ROLL, Motion.STICK)
    return np.where((figure > 0) | (friction == 0), Motion.SLIP, at_rest).astype(np.int8)


def _worst(
    rod: Rod,
    accuracy: float,
    friction: float,
    neutral: Bool[np.ndarray, "k"],
    values: Assessment,
    figure: Float[np.ndarray, "k"],
    status: Int[np.ndarray, "k"],
) -> Int[np.ndarray, "k"]:
    """The worst finding of each contact."""
    findings = [(values.depth > DEPTH_TOLERANCE, Status.PENETRATING)]
    if friction == 0:
        findings += [(figure > 0, Status.LATERALLY_UNSTABLE), (neutral, Status.HEAD_ON)]
    if rod.yield_strain is not None and rod.radius is not None:
        strain = values.largest_bend * rod.radius / rod.length
        findings.append((strain > rod.yield_strain, Status.OVERSTRAINED))
    sound = (values.residual <= accuracy) & (values.force >= 0)
    sound &= values.arc_length <= 1 + accuracy
    findings.append((~sound, Status.NOT_CONVERGED))
    for wrong, finding in findings:
        status = np.where(wrong, np.maximum(status, int(finding)), status)
    return status


def _events(
    happenings: list[tuple[int, Happening]], rod: Rod, trail: Trail, stride: int, touched: Surface
) -> list[Event]:
    """The solver's happenings, each with its trail, in the user's units."""
    if not happenings:
        return []
    n = trail.count
    positions, parameters = trail.position.reshape(-1, n, 3), trail.parameter.reshape(-1, n)
    rows = ((lane, at.index, at.fraction, *at.point) for lane, at in happenings)
    lane, index, fraction, *point = np.array(list(rows)).T
    lane, index = lane.astype(int), index.astype(int)
    share = (np.maximum(index - 1, 0) + fraction * (index > 0)) / stride
    before = np.minimum(share.astype(int), max(n - 2, 0))
    after, share = np.minimum(before + 1, n - 1), share - before
    parameter = parameters[lane, before] * (1 - share) + parameters[lane, after] * share
    ends, share = (positions[lane, at] for at in (before, after)), share[:, None]
    clamp = next(ends) * (1 - share) + next(ends) * share
    touches = np.column_stack(point) * rod.length
    if isinstance(touched, Offset):
        touches = touched.foot(touches)
    kinds = (at.kind for _, at in happenings)
    columns = kinds, lane.tolist(), parameter.tolist(), clamp, touches
    return [Event(*parts) for parts in zip(*columns, strict=True)]
