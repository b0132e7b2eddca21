"""Contacts to CSV, PLY and NetCDF, and back by other readers."""

import base64
import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import xarray
from plyfile import PlyData

import vibrissa as vb
from vibrissa.io import InputError, write_dataset

ROD = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
COLUMNS = "time,x,y,z,nx,ny,nz,arc_length,kind,status,cxx,cxy,cxz,cyy,cyz,czz"


def reactions(*, noise: bool, lanes: int = 0) -> vb.Reactions:
    """Tip contacts of a growing force that leans over; the first two rows are free, the third of a
    broken sample.
    """
    count = 12
    shape = (lanes, count) if lanes else (count,)
    rng = np.random.default_rng(6)
    load = np.linspace(0.05, 0.8, count)
    direction = np.array([0.6, 0.3, -0.8]) / np.linalg.norm([0.6, 0.3, -0.8])
    force = np.broadcast_to(load[:, None] * direction * ROD.force_scale, (*shape, 3)).copy()
    at = np.broadcast_to(np.array([0.02, 0.01, 0.045]), (*shape, 3))
    moment = np.cross(at, force)
    for part in (force, moment):
        part[..., :2, :] = 0
        part[..., 2, :] = np.nan
    trail = vb.Trail(rng.normal(size=(*shape, 3)))
    covariance = np.diag([4e-6] * 3 + [1e-9] * 3) if noise else None
    time = np.broadcast_to(0.1 + np.arange(count) / 3, shape)
    return vb.Reactions(trail, -force, -moment, time=time, covariance=covariance)


@pytest.fixture(scope="module", params=["exact", "noisy", "two trails"])
def found(request: pytest.FixtureRequest) -> vb.Reconstruction:
    lanes = 2 if request.param == "two trails" else 0
    found = vb.reconstruct(ROD, reactions(noise=request.param != "exact", lanes=lanes))
    assert set(np.unique(found.kind)) >= {vb.ContactKind.NONE}
    assert 6 <= np.count_nonzero(found.in_contact) / max(lanes, 1) <= 9
    return found


def test_csv_holds_every_digit_of_every_row(found: vb.Reconstruction, tmp_path: Path) -> None:
    file = vb.write_contacts(tmp_path / "contacts.csv", found)
    with file.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == COLUMNS.split(",")
    assert len(rows) == found.kind.size
    contact, none = [], []
    for row, index in zip(rows, np.ndindex(*found.kind.shape), strict=True):
        assert float(row["time"]) == found.reactions.time[index]
        assert (int(row["kind"]), int(row["status"])) == (found.kind[index], found.status[index])
        (contact if found.in_contact[index] else none).append((row, index))
    for row, index in contact:
        values = [float(row[name]) for name in COLUMNS.split(",")[1:8]]
        assert values == [*found.point[index], *found.normal[index], found.arc_length[index]]
        covariance = [row[name] for name in COLUMNS.split(",")[10:]]
        if found.covariance is None:
            assert covariance == [""] * 6
        else:
            upper = found.covariance[index][np.triu_indices(3)]
            assert [float(value) for value in covariance] == upper.tolist()
    for row, _ in none:
        empty = COLUMNS.split(",")[1:8] + COLUMNS.split(",")[10:]
        assert {row[name] for name in empty} == {""}


def test_a_contact_without_a_finite_place_is_none_and_never_ok(tmp_path: Path) -> None:
    """Also across blocks of rows; numbers that are not known are empty fields."""
    good = vb.reconstruct(ROD, reactions(noise=True, lanes=750))
    assert good.covariance is not None
    lost = np.flatnonzero(good.in_contact)[::7]
    point, covariance = good.point.copy(), good.covariance.copy()
    point.reshape(-1, 3)[lost] = np.nan
    covariance.reshape(-1, 3, 3)[lost + 1] = np.inf
    found = replace(good, point=point, covariance=covariance)
    status = found.status.reshape(-1)
    with vb.write_contacts(tmp_path / "contacts.csv", found).open(newline="") as stream:
        written = list(csv.DictReader(stream))
    assert {cell for row in written for cell in row.values()}.isdisjoint({"nan", "inf", "None"})
    for row in lost.tolist():
        assert (written[row]["x"], written[row]["kind"], written[row]["cxx"]) == ("", "0", "")
        assert int(written[row]["status"]) == (status[row] or vb.Status.NOT_CONVERGED)
        assert written[row + 1]["cxx"] == ""
    assert sum(row["x"] != "" for row in written) == np.count_nonzero(found.in_contact) - len(lost)
    assert len(
        PlyData.read(str(vb.write_contacts(tmp_path / "contacts.ply", found)))["vertex"].data
    ) == sum(row["x"] != "" for row in written)


def test_ply_holds_the_contacts_and_nothing_else(found: vb.Reconstruction, tmp_path: Path) -> None:
    vertex = PlyData.read(str(vb.write_contacts(tmp_path / "contacts.ply", found)))["vertex"]
    rows = found.in_contact
    for names, values in (("x y z", found.point), ("nx ny nz", found.normal)):
        np.testing.assert_array_equal(
            np.stack([vertex[name] for name in names.split()], axis=1), values[rows]
        )
    np.testing.assert_array_equal(vertex["arc_length"], found.arc_length[rows])
    np.testing.assert_array_equal(vertex["kind"], found.kind[rows])
    np.testing.assert_array_equal(vertex["status"], found.status[rows])
    assert ("standard_deviation" in vertex.data.dtype.names) == (found.covariance is not None)
    if found.covariance is not None:
        spread = [np.sqrt(np.trace(part)) for part in found.covariance[rows]]
        np.testing.assert_allclose(vertex["standard_deviation"], spread, rtol=1e-14)


def test_netcdf_holds_everything_with_units_and_meanings(
    found: vb.Reconstruction, tmp_path: Path
) -> None:
    file = vb.write_contacts(tmp_path / "contacts.nc", found)
    with xarray.open_dataset(file, engine="h5netcdf", decode_times=False) as data:
        for name, values, unit in (
            ("contact_point", found.point, "m"),
            ("normal", found.normal, "1"),
            ("arc_length", found.arc_length, "m"),
            ("bending_energy", found.energy, "J"),
            ("support_force", found.reactions.force, "N"),
            ("support_moment", found.reactions.moment, "N m"),
            ("clamp_position", found.reactions.trail.position, "m"),
            ("time", found.reactions.time, "s"),
        ):
            np.testing.assert_array_equal(data[name].values, values)
            assert data[name].attrs["units"] == unit
        if found.covariance is not None:
            np.testing.assert_array_equal(data["contact_point_covariance"].values, found.covariance)
            assert data["contact_point_covariance"].attrs["units"] == "m2"
        for name, values, members in (
            ("kind", found.kind, vb.ContactKind),
            ("status", found.status, vb.Status),
        ):
            np.testing.assert_array_equal(data[name].values, values)
            meanings = dict(
                zip(
                    data[name].attrs["flag_values"],
                    data[name].attrs["flag_meanings"].split(),
                    strict=True,
                )
            )
            assert meanings == {int(member): member.name.lower() for member in members}
        assert data.sizes["axis"] == 3
        assert data.attrs["rod_length"] == ROD.length


def test_model_units_are_written_as_such(tmp_path: Path) -> None:
    rod, si = vb.Rod.unit(), reactions(noise=False)
    scaled = vb.Reactions(si.trail, si.force / ROD.force_scale, si.moment / ROD.moment_scale)
    found = vb.reconstruct(rod, scaled)
    assert found.to_dataset()["contact_point"].attrs["units"] == "1"
    assert found.to_dataset()["support_force"].attrs["units"] == "1"
    assert (
        "rod length"
        in PlyData.read(str(vb.write_contacts(tmp_path / "contacts.ply", found))).comments[0]
    )


def test_no_contact_at_all_gives_files_without_points(tmp_path: Path) -> None:
    trail, zero = vb.Trail(np.zeros((3, 3))), np.zeros((3, 3))
    found = vb.reconstruct(ROD, vb.Reactions(trail, zero, zero))
    assert (
        len(PlyData.read(str(vb.write_contacts(tmp_path / "contacts.ply", found)))["vertex"].data)
        == 0
    )
    assert (
        vb.write_contacts(tmp_path / "contacts.csv", found).read_text().splitlines()[1:]
        == [",,,,,,,,0,0,,,,,,"] * 3
    )


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mat", ".ply", ".nc"])
def test_what_is_written_is_read(found: vb.Reconstruction, tmp_path: Path, suffix: str) -> None:
    """To the last digit, as `Contacts`; PLY holds contacts alone, the others a row a sample."""
    got = vb.read_contacts(vb.write_contacts(tmp_path / f"contacts{suffix}", found))
    rows = found.in_contact if suffix == ".ply" else np.ones_like(found.in_contact)
    for name in ("point", "normal", "arc_length", "kind", "status"):
        expected = getattr(found, name)
        expected = expected if suffix == ".nc" else expected[rows]
        np.testing.assert_array_equal(getattr(got, name), expected)
    if suffix == ".ply":
        assert got.time is got.covariance is None
        return
    shape = got.kind.shape
    np.testing.assert_array_equal(got.time, found.reactions.time.reshape(shape))
    if found.covariance is None:
        assert got.covariance is None
    else:
        there = found.in_contact.reshape(shape)
        expected = found.covariance.reshape(*shape, 3, 3)[there]
        symmetric = np.triu(expected) + np.triu(expected, 1).swapaxes(-1, -2)
        np.testing.assert_array_equal(
            got.covariance[there], expected if suffix == ".nc" else symmetric
        )


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mat", ".ply", ".nc"])
def test_contacts_of_a_scan_are_read(tmp_path: Path, suffix: str) -> None:
    trail = vb.Trail.line(start=(1.2, 0.2, 0), stop=(-1.2, 0.2, 0), count=21)
    scan = vb.scan(vb.Rod.unit(), vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4), trail)
    got = vb.read_contacts(vb.write_contacts(tmp_path / f"contacts{suffix}", scan))
    expected = scan.contacts[scan.in_contact] if suffix == ".ply" else scan.contacts
    assert 5 < np.count_nonzero(got.kind) < 21
    for name in ("point", "normal", "arc_length", "kind", "status"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    if suffix == ".nc":
        np.testing.assert_array_equal(got.force_direction, scan.force_direction)


@pytest.mark.parametrize(
    ("suffix", "digits"), [(".vtp", 0.0), (".pcd", 2.0**-23), (".mcap", 2.0**-23)]
)
def test_clouds_for_other_programs_are_read(
    found: vb.Reconstruction, tmp_path: Path, suffix: str, digits: float
) -> None:
    """Contacts alone, to the digits of the format; MCAP holds deviations in place of covariances."""
    got = vb.read_contacts(vb.write_contacts(tmp_path / f"contacts{suffix}", found))
    rows = found.in_contact
    for name in ("point", "normal", "arc_length"):
        np.testing.assert_allclose(getattr(got, name), getattr(found, name)[rows], rtol=digits)
    for name in ("kind", "status"):
        np.testing.assert_array_equal(getattr(got, name), getattr(found, name)[rows])
    np.testing.assert_allclose(got.time, found.reactions.time[rows], atol=1e-9)
    if found.covariance is None or suffix == ".mcap":
        assert got.covariance is None
    else:
        scale = np.abs(found.covariance[rows]).max()
        np.testing.assert_allclose(
            got.covariance, found.covariance[rows], rtol=digits, atol=1e-15 * scale
        )


@pytest.mark.parametrize("suffix", [".vtp", ".pcd", ".mcap"])
def test_clouds_without_a_point_or_a_time(tmp_path: Path, suffix: str) -> None:
    trail, zero = vb.Trail(np.zeros((3, 3))), np.zeros((3, 3))
    found = vb.reconstruct(ROD, vb.Reactions(trail, zero, zero))
    got = vb.read_contacts(vb.write_contacts(tmp_path / f"contacts{suffix}", found))
    assert got.point.shape == (0, 3)
    untimed = replace(reactions(noise=True), time=None)
    some = vb.read_contacts(
        vb.write_contacts(tmp_path / f"some{suffix}", vb.reconstruct(ROD, untimed))
    )
    assert some.time is None
    assert len(some) > 5


def test_a_vtp_by_its_specification(found: vb.Reconstruction, tmp_path: Path) -> None:
    """Each array is base64 of its number of bytes, in 64 bits, and its values; a vertex a point."""
    root = ElementTree.parse(vb.write_contacts(tmp_path / "contacts.vtp", found)).getroot()
    assert (root.get("type"), root.get("header_type")) == ("PolyData", "UInt64")
    piece = root.find("PolyData/Piece")
    count = np.count_nonzero(found.in_contact)
    assert piece.get("NumberOfPoints") == piece.get("NumberOfVerts") == str(count)
    kinds = {"Float64": "<f8", "UInt8": "u1", "Int64": "<i8"}
    arrays = {}
    for array in root.iter("DataArray"):
        content = base64.b64decode(array.text)
        assert int.from_bytes(content[:8], "little") == len(content) - 8
        arrays[array.get("Name")] = np.frombuffer(content[8:], kinds[array.get("type")])
    np.testing.assert_array_equal(arrays["Points"].reshape(-1, 3), found.point[found.in_contact])
    np.testing.assert_array_equal(arrays["connectivity"], np.arange(count))
    np.testing.assert_array_equal(arrays["offsets"], 1 + np.arange(count))
    if found.covariance is not None:
        np.testing.assert_allclose(
            arrays["covariance"].reshape(-1, 3, 3), found.covariance[found.in_contact], rtol=1e-12
        )


def test_a_pcd_by_its_specification(found: vb.Reconstruction, tmp_path: Path) -> None:
    """A header of lines, then rows of bytes; places and normals are what PCL's points hold."""
    content = vb.write_contacts(tmp_path / "contacts.pcd", found).read_bytes()
    text, _, data = content.partition(b"DATA binary\n")
    header = dict(line.split(" ", 1) for line in text.decode().splitlines() if line[0] != "#")
    names, sizes, types = (header[name].split() for name in ("FIELDS", "SIZE", "TYPE"))
    assert names[:6] == ["x", "y", "z", "normal_x", "normal_y", "normal_z"]
    kind = np.dtype(
        [
            (name, f"{'f' if of == 'F' else 'u'}{size}")
            for name, of, size in zip(names, types, sizes, strict=True)
        ]
    )
    assert kind["x"] == kind["normal_z"] == np.float32
    points = np.frombuffer(data, kind)
    assert header["POINTS"] == str(len(points))
    np.testing.assert_array_equal(
        np.stack([points[axis] for axis in "xyz"], axis=1),
        found.point[found.in_contact].astype(np.float32),
    )
    assert ("standard_deviation" in names) == (found.covariance is not None)


def test_no_contact_and_no_time_is_read(tmp_path: Path) -> None:
    trail, zero = vb.Trail(np.zeros((3, 3))), np.zeros((3, 3))
    found = vb.reconstruct(ROD, vb.Reactions(trail, zero, zero))
    table = vb.read_contacts(vb.write_contacts(tmp_path / "contacts.csv", found))
    assert table.kind.tolist() == [0, 0, 0]
    assert table.time is table.covariance is None
    assert np.isnan(table.point).all()
    cloud = vb.read_contacts(vb.write_contacts(tmp_path / "contacts.ply", found))
    assert cloud.point.shape == (0, 3)


DAMAGE = {
    "cut csv": (".csv", lambda content: content[:-9] if content.endswith(b",,\r\n") else content[: content.rindex(b",")], "truncated"),
    "cut csv at a line": (".csv", lambda content: content[: content.rindex(b",", 0, -9)], "truncated"),
    "csv of words": (".csv", lambda content: content.replace(b"0.1", b"one", 1), "'one"),
    "another table": (".csv", lambda content: content.replace(b"arc_length", b"length", 1), "columns: missing arc_length; allowed are x,y,z"),
    "cut ply": (".ply", lambda content: content[:-5], "damaged"),
    "no ply": (".ply", lambda _: b"x,y,z\n1,2,3\n", "damaged"),
    "another cloud": (".ply", lambda content: content.replace(b" nx", b" qx", 1), "nx: missing"),
    "cut vtp": (".vtp", lambda content: content[:-40], "damaged"),
    "another vtp": (".vtp", lambda content: content.replace(b"binary", b"ascii"), "write_contacts"),
    "cut pcd": (".pcd", lambda content: content[:-5], "damaged"),
    "cut mcap": (".mcap", lambda content: content[: len(content) // 2], "damaged"),
    "cut nc": (".nc", lambda content: content[: len(content) // 2], "damaged"),
    "another dataset": (".nc", None, "arc_length, contact_point, kind, normal, status: missing"),
}  # fmt: skip


@pytest.mark.parametrize("what", DAMAGE)
def test_damaged_contacts_are_one_line_that_names_the_file(
    found: vb.Reconstruction, tmp_path: Path, what: str
) -> None:
    suffix, damage, words = DAMAGE[what]
    file = tmp_path / f"contacts{suffix}"
    if damage is None:
        write_dataset(file, xarray.Dataset({"a": ("x", [1.0])}))
    else:
        file.write_bytes(damage(vb.write_contacts(file, found).read_bytes()))
    message = refusal(lambda: vb.read_contacts(file))
    assert message.startswith((f"{file}: ", f"{file}, line "))
    assert words in message


def test_columns_of_others_are_ignored_and_large_numbers_read(
    found: vb.Reconstruction, tmp_path: Path
) -> None:
    file = vb.write_contacts(tmp_path / "contacts.csv", found)
    expected = vb.read_contacts(file)
    heading, *rows = file.read_text().splitlines()
    largest = [row.replace(row.split(",")[0], "1.6e18", 1) for row in rows]
    file.write_text("\n".join([f"note,{heading},note", *(f"a,{row},b" for row in largest), ""]))
    got = vb.read_contacts(file)
    np.testing.assert_array_equal(got.point, expected.point)
    assert got.time is not None
    assert set(got.time) == {1.6e18}
    file.write_text("\n".join([f"{heading},cxx", *(f"{row},0" for row in rows), ""]))
    assert "line 1: columns: twice cxx" in refusal(lambda: vb.read_contacts(file))


def test_contacts_that_are_not_there(tmp_path: Path) -> None:
    assert "cannot be read" in refusal(lambda: vb.read_contacts(tmp_path / "none.csv"))
    assert (
        "suffix '.txt'; allowed are .ply, .csv, .nc, .parquet, .vtp, .pcd, .mcap, .mat"
        in refusal(lambda: vb.read_contacts(tmp_path / "none.txt"))
    )


def refusal(write: Callable[[], object]) -> str:
    with pytest.raises(InputError) as caught:
        write()
    message = str(caught.value)
    assert "\n" not in message
    assert "allowed" in message
    return message


@pytest.mark.parametrize("name", ["contacts.stl", "contacts", "contacts.csv.gz"])
def test_another_suffix_is_refused(found: vb.Reconstruction, tmp_path: Path, name: str) -> None:
    message = refusal(lambda: vb.write_contacts(tmp_path / name, found))
    assert f"{name}: suffix" in message
    assert "allowed are .ply, .csv, .nc, .parquet" in message
    assert list(tmp_path.iterdir()) == []


def test_contacts_without_a_unit_are_refused(
    found: vb.Reconstruction, tmp_path: Path, no_shape_checks: None
) -> None:
    with pytest.raises(ValueError, match="found is a Contacts; allowed are a Reconstruction"):
        vb.write_contacts(tmp_path / "contacts.nc", found.contacts)


def test_a_dataset_is_netcdf_only(found: vb.Reconstruction, tmp_path: Path) -> None:
    assert "allowed are .nc" in refusal(
        lambda: write_dataset(tmp_path / "a.csv", found.to_dataset())
    )


def test_folders_are_made(found: vb.Reconstruction, tmp_path: Path) -> None:
    assert vb.write_contacts(tmp_path / "new" / "deep" / "contacts.csv", found).stat().st_size > 0
    assert [file.name for file in (tmp_path / "new" / "deep").iterdir()] == ["contacts.csv"]


def test_a_folder_that_cannot_be_made_is_named(found: vb.Reconstruction, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file where a folder should be")
    message = refusal(lambda: vb.write_contacts(tmp_path / "taken" / "contacts.csv", found))
    assert f"{tmp_path / 'taken'}: the output folder cannot be made" in message


def test_a_folder_that_cannot_be_written_to_is_named(
    found: vb.Reconstruction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Permissions do not bind every user who runs tests, so the refusal of the system is put in its
    place.
    """

    def refuse(_path: Path, *_args: object, **_options: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "touch", refuse)
    message = refusal(lambda: vb.write_contacts(tmp_path / "contacts.csv", found))
    assert message.startswith(f"{tmp_path}: the output folder is not writable (Permission denied)")


def test_a_folder_in_place_of_the_file_is_named(found: vb.Reconstruction, tmp_path: Path) -> None:
    (tmp_path / "contacts.csv").mkdir()
    assert "is a folder; allowed is a file" in refusal(
        lambda: vb.write_contacts(tmp_path / "contacts.csv", found)
    )


def test_a_file_that_may_not_be_overwritten_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = vb.reconstruct(ROD, reactions(noise=False))
    file = tmp_path / "contacts.csv"
    file.touch()
    opened = Path.open

    def refuse(path: Path, mode: str = "r", *args: object, **options: object) -> object:
        if path == file and "w" in mode:
            raise PermissionError(13, "Permission denied")
        return opened(path, mode, *args, **options)

    monkeypatch.setattr(Path, "open", refuse)
    assert str(file) in refusal(lambda: vb.write_contacts(file, found))
