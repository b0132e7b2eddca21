"""What a scan returns."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.brief import counts
from vibrissa.contacts import ContactKind, Contacts, Status
from vibrissa.forward.events import Event, EventKind
from vibrissa.forward.slip import Slip, led, slip_along
from vibrissa.forward.validity import QuasiStatic, quasi_static
from vibrissa.mechanics.shape import CentreLine, Held, elastic_lines
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.trail import Trail

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class Scan(CentreLine):
    """Equilibria of the rod along one trail (n, …) or several (m, n, …), in units of the rod, world
    axes.

    Attributes
    ----------
    rod, surface, trail
        The rod, the object, and the clamp poses.
    kind
        (…) values of `ContactKind`.
    point, normal
        Contact point and outward unit normal of the object there (…, 3); NaN without contact.
    force_direction
        Unit vector (…, 3) of the contact force on the rod: the normal without friction, inside the
        friction cone with it.
    motion
        (…) values of `Motion`: without friction a contact always slips.
    arc_length
        s₁ (…) [m]: arc length of the contact from the clamp; NaN without contact.
    reactions
        Support reactions, on the rod, moment about the clamp; zero without contact, NaN where
        unsolved.
    contact_force
        What the object exerts on the rod (…, 3): without distributed loads, the support force with
        the other sign.
    energy
        Bending energy (…) [J].
    largest_curvature
        (…) [1/m] along the rod: at the clamp, or further out where the contact force passes behind
        the clamp axis.
    largest_bend
        (…) [1/m]: the largest change of curvature by load, times the radius there over that at the
        clamp.
    contact_tangent, plane_normal
        Unit tangent of the rod at the contact and unit normal t0 × n of its bending plane (…, 3).
    residual
        Largest residual (…) of the contact conditions of the returned state, dimensionless.
    depth
        How deep (…) [m] the elastic line enters the object at the deepest of some 700 points,
        evaluated where fewer leave it open; at rounding level where it does not enter.
    status
        (…) values of `Status`.
    events
        By trail, in order along each.
    friction
        Coefficient of friction, as given.
    finite_radius
        As given.
    offset
        By how much [m] the object was grown for the rod's centre line: the rod's radius at the
        clamp with `finite_radius`, else that of an `Offset`, else 0. `point` is on the object
        itself, and `centre` on the centre line.
    second_contact
        (…, 3) where the rod also touches the object or passes through it, on rows whose status says
        so; NaN on the others.
    """

    rod: Rod
    surface: Surface
    trail: Trail
    kind: Int[np.ndarray, "*trail n"]
    point: Float[np.ndarray, "*trail n 3"]
    normal: Float[np.ndarray, "*trail n 3"]
    force_direction: Float[np.ndarray, "*trail n 3"]
    motion: Int[np.ndarray, "*trail n"]
    arc_length: Float[np.ndarray, "*trail n"]
    reactions: Reactions
    contact_force: Float[np.ndarray, "*trail n 3"]
    energy: Float[np.ndarray, "*trail n"]
    largest_curvature: Float[np.ndarray, "*trail n"]
    largest_bend: Float[np.ndarray, "*trail n"]
    contact_tangent: Float[np.ndarray, "*trail n 3"]
    plane_normal: Float[np.ndarray, "*trail n 3"]
    residual: Float[np.ndarray, "*trail n"]
    depth: Float[np.ndarray, "*trail n"]
    status: Int[np.ndarray, "*trail n"]
    events: list[Event]
    friction: float
    finite_radius: bool
    offset: float
    second_contact: Float[np.ndarray, "*trail n 3"]

    def __repr__(self) -> str:
        """Return five lines: rod and object, kinds, statuses, loads, and events."""
        force = np.linalg.norm(self.reactions.force, axis=-1)
        largest = f"{np.nanmax(force):.4g}" if np.isfinite(force).any() else "unknown"
        unit = self.rod.unit_of("force").replace("1", "EI/L²")
        happened = counts([event.kind for event in self.events], EventKind)
        return (
            f"Scan of {type(self.surface).__name__} at {self.kind.size} positions "
            f"{self.kind.shape}\n"
            f"  kind: {counts(self.kind, ContactKind)}\n"
            f"  status: {counts(self.status, Status)}\n"
            f"  friction: {self.friction:g}, largest support force: {largest} {unit}\n"
            f"  events: {happened or 'none'}"
        )

    @property
    def contacts(self) -> Contacts:
        """Where the rod touches, one row per position (…)."""
        return Contacts.of(self, self.reactions.time)

    @property
    def in_contact(self) -> Bool[np.ndarray, "*trail n"]:
        """Whether a contact was found (…)."""
        return self.kind != ContactKind.NONE

    @property
    def solved(self) -> Bool[np.ndarray, "*trail n"]:
        """Whether the row holds an equilibrium (…), with contact or without, whatever its checks
        say.
        """
        return np.isfinite(self.energy)

    @property
    def bending_strain(self) -> Float[np.ndarray, "*trail n"]:
        """Largest bending strain (…): of local radius times change of curvature along the rod.

        Raises
        ------
        ValueError
            If the rod has no radius.
        """
        if self.rod.radius is None:
            raise ValueError("radius = None: a bending strain needs the rod's radius")
        return self.rod.radius * self.largest_bend

    @cached_property
    def slip(self) -> Slip:
        """Axial, longitudinal and lateral slip of each step (mechanics.md, "Slip")."""
        return slip_along(
            self.centre,
            self.arc_length,
            self.contact_tangent,
            self.plane_normal,
        )

    @cached_property
    def clamp_work(self) -> Float[np.ndarray, "*trail n"]:
        """Work (…) [J] done by the clamp on the rod since the previous position, by the trapezoidal
        rule; NaN on the first row and next to unsolved ones.
        """
        return led(self.reactions.clamp_work)

    @cached_property
    def friction_work(self) -> Float[np.ndarray, "*trail n"]:
        """Work (…) [J] that friction turns into heat since the previous position, by the
        trapezoidal rule for the tangential force, so that a normal turning within the step, as at
        an edge, does no work. The error is up to half the change of the tangential force times the
        sliding distance.

        NaN where either position has no contact, and across a snap, for which statics gives both
        ends but not the path.
        """
        force = self.contact_force
        push = np.einsum("...i,...i->...", force, self.normal)
        friction = force - push[..., None] * self.normal
        friction = (friction[..., 1:, :] + friction[..., :-1, :]) / 2
        heat = led(-np.einsum("...i,...i->...", friction, self.slip.sliding[..., 1:, :]))
        heat[self._behind_a_snap] = np.nan
        return heat

    def quasi_static(self, speed: float) -> QuasiStatic:
        """Whether a clamp speed [m/s] is slow enough for statics, given the rod's density.

        Raises
        ------
        ValueError
            If the rod has no density, or the speed is not positive.
        """
        return quasi_static(
            self.rod,
            self.trail,
            self.reactions.force,
            self.reactions.moment,
            ~self._behind_a_snap,
            speed,
        )

    @property
    def _behind_a_snap(self) -> Bool[np.ndarray, "*trail n"]:
        """The first position after each snap."""
        behind = np.zeros(self.kind.shape, dtype=bool)
        for event in self.events:
            if event.kind == EventKind.SNAP:
                trail = (event.trail,) if self.kind.ndim == 2 else ()
                behind[(*trail, np.searchsorted(self.trail.parameter[trail], event.parameter))] = (
                    True
                )
        return behind

    def elastic_line(
        self, index: "int | tuple[int, int]", count: int = 200
    ) -> Float[np.ndarray, "count 3"]:
        """The rod's shape at a position: `count` points equally spaced in arc length from clamp to
        tip. A support that yields moves the first of them off the clamp point.

        Parameters
        ----------
        index
            Position i on one trail, or (trail, i) on several.
        count
            Number of points, at least 2.

        Raises
        ------
        ValueError
            If the position was not solved, or `count` is less than 2.
        IndexError
            If there is no such position.
        """
        if self.trail.position[index].ndim != 1:
            raise ValueError(
                f"index = {index}; allowed is (trail, i), as the scan holds several trails"
            )
        if not self.solved[index]:
            raise ValueError(
                f"index = {index}: this position was not solved: "
                f"{Status(int(self.status[index])).text}"
            )
        return self.elastic_lines(index, count)[0]

    def elastic_lines(self, rows: Any, count: int = 200) -> Float[np.ndarray, "k count 3"]:
        """The rod's shapes at some rows, chosen by index, slice or mask, one after another; NaN
        where unsolved. Many at once take less time.

        Raises
        ------
        ValueError
            If `count` is less than 2.
        """
        point = self.centre
        contact = self.in_contact, point, self.force_direction, self.arc_length
        return elastic_lines(self.rod, Held(self.reactions, *contact), rows, count)

    def to_dataset(self) -> "xarray.Dataset":
        """All fields as an `xarray.Dataset` with CF-style units and flag meanings."""
        from vibrissa.forward.dataset import scan_dataset  # noqa: PLC0415

        return scan_dataset(self)
