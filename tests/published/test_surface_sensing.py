"""Merker, Scharff, Zimmermann, Behn: Surface Sensing of 3D Objects Using Vibrissa-like Intelligent
Tactile Sensors. Section III, end to end.
"""

import csv
import struct
from pathlib import Path

import numpy as np
import pytest
import xarray

from vibrissa.paper import Demo, run_demo
from vibrissa.paper import case as paper


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Demo, Path]:
    import matplotlib as mpl

    mpl.use("Agg")
    folder = tmp_path_factory.mktemp("demo")
    return run_demo(folder, lambda _: None), folder


def test_every_statement_holds(demo: tuple[Demo, Path]) -> None:
    result, folder = demo
    assert len(result.statements) >= 18
    assert [part.statement for part in result.statements if not part.holds] == []
    with (folder / "statements.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["holds"] for row in rows] == ["yes"] * len(result.statements)


def test_figures_are_written_at_journal_resolution(demo: tuple[Demo, Path]) -> None:
    _, folder = demo
    for name in (
        "figure2_reactions",
        "figure3a_elastic_lines",
        "figure3b_contacts",
        "plane_case",
        "coverage",
    ):
        header = (folder / f"{name}.png").read_bytes()[:24]
        width, height = struct.unpack(">II", header[16:24])
        assert header.startswith(b"\x89PNG")
        assert min(width, height) > 500
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_further_sweeps_reach_more_of_the_surface(demo: tuple[Demo, Path]) -> None:
    shares = list(demo[0].coverage.values())
    assert shares == sorted(shares)
    # The area of a strip of 0.05 L to each side of the contacts bounds the first share from above.
    assert 0.2 < shares[0] < 0.4
    assert shares[1] > shares[0] + 0.05
    assert shares[2] > 0.7


def test_the_datasets_hold_the_table_of_phase_changes(demo: tuple[Demo, Path]) -> None:
    with xarray.open_dataset(demo[1] / "paper_scan.nc", engine="h5netcdf") as data:
        kinds, trails, clamp = (
            data["event_kind"].values,
            data["event_trail"].values,
            data["event_clamp"].values,
        )
        force = np.linalg.norm(data["support_force"].values, axis=-1)
        x0 = data["clamp_position"].values[..., 0]
        assert data["support_moment"].attrs["units"] == "1"
        assert data["kind"].attrs["flag_meanings"] == "none tip tangential"
    # First contact and phase change as in 40-digit arithmetic, on both sides of the plane of
    # symmetry.
    expected = {
        0.1: (1.08627804912002, 0.452652731517856),
        0.2: (1.05830052442584, 0.37292343378556),
        0.3: (1.00995049383621, 0.158017679525689),
    }
    for lane, y0 in enumerate(paper.Y0):
        if abs(y0) in expected:
            first, change = expected[abs(y0)]
            assert clamp[(trails == lane) & (kinds == 1), 0] == pytest.approx([first], abs=1e-11)
            assert clamp[(trails == lane) & (kinds == 2), 0] == pytest.approx([change], abs=1e-11)
            assert clamp[(trails == lane) & (kinds == 3), 0] == pytest.approx([-change], abs=1e-11)
    at_zero = np.isclose(x0, 0, atol=1e-12)
    assert force[np.abs(paper.Y0) == 0.2][at_zero[np.abs(paper.Y0) == 0.2]] == pytest.approx(
        2.04661147, abs=1e-8
    )
    assert force[np.abs(paper.Y0) == 0.5][at_zero[np.abs(paper.Y0) == 0.5]] == pytest.approx(
        0.79522661, abs=1e-8
    )
