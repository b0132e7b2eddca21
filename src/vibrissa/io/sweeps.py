"""Scans and reconstructions read back from NetCDF, as far as they can be drawn."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind
from vibrissa.files import InputError, readable, reading
from vibrissa.mechanics.shape import CentreLine, Held, elastic_lines
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod, rod_from_json
from vibrissa.trail import Trail

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class StoredSweep(CentreLine):
    """One trail (n, …) or several (m, n, …) as a file holds them, in units of the rod.

    Attributes
    ----------
    rod, reactions, kind, status, point, normal, force_direction, arc_length, energy
        As of `vibrissa.Scan`.
    covariance
        (…, 3, 3) of the points, or None.
    incidence
        (…) as `vibrissa.Reconstruction.modulus`; None for a scan, whose force is exact.
    offset, finite_radius
        As of a scan; 0 and False for a reconstruction.
    """

    rod: Rod
    reactions: Reactions
    kind: Int[np.ndarray, "*trail n"]
    status: Int[np.ndarray, "*trail n"]
    point: Float[np.ndarray, "*trail n 3"]
    normal: Float[np.ndarray, "*trail n 3"]
    force_direction: Float[np.ndarray, "*trail n 3"]
    arc_length: Float[np.ndarray, "*trail n"]
    energy: Float[np.ndarray, "*trail n"]
    covariance: Float[np.ndarray, "*trail n 3 3"] | None
    incidence: Float[np.ndarray, "*trail n"] | None
    offset: float
    finite_radius: bool

    @property
    def in_contact(self) -> Bool[np.ndarray, "*trail n"]:
        """Whether a contact was found (…)."""
        return self.kind != ContactKind.NONE

    def elastic_lines(self, rows: Any, count: int = 200) -> Float[np.ndarray, "k count 3"]:
        """The rod's shapes at some rows, as `vibrissa.Scan.elastic_lines`."""
        contact = (
            self.in_contact,
            self.centre,
            self.force_direction,
            self.arc_length,
            self.incidence,
        )
        return elastic_lines(self.rod, Held(self.reactions, *contact), rows, count)


def is_sweep(path: Path) -> bool:
    """Whether a file is NetCDF that holds a scan or a reconstruction."""
    import h5py  # noqa: PLC0415

    if not h5py.is_hdf5(readable(path)):
        return False
    with reading(path, "NetCDF"), h5py.File(path, "r") as opened:
        return {"contact_point", "kind", "rod_length"} <= {*opened, *opened.attrs}


def read_sweep(path: str | Path) -> StoredSweep:
    """Read a scan or a reconstruction from NetCDF.

    Raises
    ------
    InputError
        If the file cannot be read, or was not written by `vibrissa scan` or `reconstruct`.
    """
    import xarray  # noqa: PLC0415

    file = Path(path)
    if not is_sweep(file):
        raise InputError(f"{file}: holds no sweep; allowed is NetCDF of a scan or a reconstruction")
    with (
        reading(file, "NetCDF"),
        xarray.open_dataset(file, engine="h5netcdf", decode_times=False) as data,
    ):
        return _of(data)


def _of(data: "xarray.Dataset") -> StoredSweep:
    def part(name: str) -> Any:
        return data[name].to_numpy() if name in data else None

    rod = _rod(data)
    trail = Trail(part("clamp_position"), part("clamp_orientation"))
    reactions = Reactions(trail, part("support_force"), part("support_moment"), part("time"))
    direction = part("force_direction")
    offset = float(data.attrs.get("contact_offset", 0.0))
    return StoredSweep(
        rod,
        reactions,
        kind=part("kind").astype(int),
        status=part("status").astype(int),
        point=part("contact_point"),
        normal=part("normal"),
        # Older reconstructions hold it as their normal only.
        force_direction=part("normal") if direction is None else direction,
        arc_length=part("arc_length"),
        energy=part("bending_energy"),
        covariance=part("contact_point_covariance"),
        incidence=part("incidence"),
        offset=offset,
        # Older scans say by the offset only.
        finite_radius=bool(data.attrs.get("finite_radius", offset > 0)),
    )


def _rod(data: "xarray.Dataset") -> Rod:
    if "rod" in data:
        return rod_from_json(str(data["rod"].item()))
    # Older files hold uniform, straight rods only.
    is_model = data["contact_point"].attrs["units"] == "1"
    return Rod(
        float(data.attrs["rod_length"]),
        float(data.attrs["rod_bending_stiffness"]),
        units="model" if is_model else "SI",
    )
