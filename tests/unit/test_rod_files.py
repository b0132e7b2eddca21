"""Rods in cases, setups and results."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vibrissa as vb
from vibrissa.io import InputError
from vibrissa.io.sweeps import read_sweep
from vibrissa.rod import rod_from_json, rod_to_json

REST = """
[object]
kind = "sphere"
center = [0, 0, 0.06]
radius = 0.02
[[trail]]
kind = "line"
start = [0.03, 0, 0]
stop = [-0.03, 0, 0]
count = 5
"""


def rod(folder: Path, table: str) -> vb.Rod:
    (folder / "case.toml").write_text(f"[rod]\n{table}\n{REST}", encoding="utf-8")
    return vb.load_case(folder / "case.toml").rod


CYLINDER = 'kind = "cylinder"\nlength = 0.05\nradius = 2e-4\nyoungs_modulus = 2e11\n'
THERMAL = vb.Thermal(modulus_slope=-3e-4, expansion=1.2e-5)
WIRE = vb.Rod.cylinder(length=0.05, radius=2e-4, youngs_modulus=2e11)
HEAVY = vb.Rod.cylinder(length=0.05, radius=2e-4, youngs_modulus=2e11, density=7850.0)
WHISKER = vb.Rod.tapered(
    length=0.05,
    base_radius=1e-4,
    tip_radius=1e-6,
    youngs_modulus=3e9,
    density=1200.0,
    poisson_ratio=0.4,
)
KINDS = {
    "a tube": (
        CYLINDER + "inner_radius = 1e-4\npoisson_ratio = 0.25",
        vb.Rod.cylinder(
            length=0.05,
            radius=2e-4,
            youngs_modulus=2e11,
            inner_radius=1e-4,
            poisson_ratio=0.25,
        ),
    ),
    "a taper": (
        'kind = "tapered"\nlength = 0.05\nbase_radius = 1e-4\ntip_radius = 1e-6\n'
        "youngs_modulus = 3e9\ndensity = 1200\npoisson_ratio = 0.4",
        WHISKER,
    ),
    "a table of radii": (
        'kind = "table"\narc_length = [0, 0.02, 0.05]\nradius = [3e-4, 3e-4, 1e-4]\n'
        "youngs_modulus = 2e9\ninner_radius = [1e-4, 0, 0]",
        vb.Rod.from_table(
            arc_length=(0, 0.02, 0.05),
            radius=(3e-4, 3e-4, 1e-4),
            youngs_modulus=2e9,
            inner_radius=(1e-4, 0, 0),
        ),
    ),
    "a table of stiffness": (
        'kind = "table"\narc_length = [0, 0.05]\nbending_stiffness = [1e-3, 1e-4]\n'
        "torsional_stiffness = [1e-3, 1e-4]\nlinear_density = [1e-3, 1e-3]",
        vb.Rod.from_table(
            arc_length=(0, 0.05),
            bending_stiffness=(1e-3, 1e-4),
            torsional_stiffness=(1e-3, 1e-4),
            linear_density=(1e-3, 1e-3),
        ),
    ),
    "the model's units": (
        'kind = "unit"\n[rod.rest]\nkind = "arc"\nradius = 2.0',
        vb.Rod.unit().curved(vb.RestShape.arc(2.0)),
    ),
    "a polynomial": (
        CYLINDER + '[rod.rest]\nkind = "polynomial"\ncoefficients = [1, 20]\nroll = 0.5',
        WIRE.curved(vb.RestShape.polynomial((1, 20), roll=0.5)),
    ),
    "a parabola": (
        CYLINDER + '[rod.rest]\nkind = "parabola"\na = 9',
        WIRE.curved(vb.RestShape.parabola(9.0)),
    ),
    "points": (
        CYLINDER + '[rod.rest]\nkind = "points"\n'
        "points = [[0, 0, 0], [1e-5, 0, 0.02], [4e-5, 0, 0.04], [6e-5, 0, 0.05]]",
        WIRE.curved(
            vb.RestShape.from_points([[0, 0, 0], [1e-5, 0, 0.02], [4e-5, 0, 0.04], [6e-5, 0, 0.05]])
        ),
    ),
    "components": (
        CYLINDER + '[rod.rest]\nkind = "components"\narc_length = [0, 0.05]\n'
        "curvature = [[1, 2, 3], [3, 2, 1]]",
        WIRE.curved(vb.RestShape.from_components((0, 0.05), [[1, 2, 3], [3, 2, 1]])),
    ),
    "loads": (
        CYLINDER + "density = 7850\n[rod.loads]\ngravity = [0, 0, -9.81]\nwind = [1, 0, 0]\n"
        "fluid_density = 1000\nviscosity = 1e-3",
        HEAVY.loaded(
            vb.Loads(gravity=(0, 0, -9.81), wind=(1, 0, 0), fluid_density=1000.0, viscosity=1e-3)
        ),
    ),
    "a pivot": (
        CYLINDER + '[rod.support]\nkind = "pivot"\nstiffness = [1, 2, 3]',
        WIRE.on(vb.Support.pivot((1.0, 2.0, 3.0))),
    ),
    "a compliant support": (
        CYLINDER + '[rod.support]\nkind = "compliant"\nstiffness = '
        f"{np.diag([4.0, 5, 6, 1, 2, 3]).tolist()}",
        WIRE.on(vb.Support.compliant(np.diag([4.0, 5, 6, 1, 2, 3]))),
    ),
    "a rigid support": (CYLINDER + '[rod.support]\nkind = "rigid"', WIRE),
    "a temperature": (
        CYLINDER + "temperature = 40\n[rod.thermal]\nmodulus_slope = -3e-4\nexpansion = 1.2e-5",
        replace(WIRE, thermal=THERMAL).at(temperature=40.0),
    ),
}


@pytest.mark.parametrize("what", KINDS)
def test_tables_describe_rods_and_results_keep_them(tmp_path: Path, what: str) -> None:
    table, expected = KINDS[what]
    found = rod(tmp_path, table)
    assert found == expected
    assert rod_from_json(rod_to_json(found)) == found


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (CYLINDER + "taper = 1", "rod.taper: unknown key"),
        (CYLINDER + "poisson_ratio = 0.7", "rod.poisson_ratio = 0.7: allowed is a number above -1"),
        (
            CYLINDER + '[rod.rest]\nkind = "circle"',
            "rod.rest.kind = 'circle': allowed is arc, polynomial, parabola, points or components",
        ),
        (CYLINDER + "rest = 3", "rod.rest = 3: allowed is a table of kind arc, polynomial, "),
        (CYLINDER + '[rod.rest]\nkind = "arc"', "rod.rest.radius: missing"),
        (
            CYLINDER + '[rod.rest]\nkind = "arc"\nradius = 1e-3',
            "rod.rest: the rod touches itself at arc lengths",
        ),
        (CYLINDER + "[rod.loads]\ngravity = [0, 0]", "rod.loads.gravity = "),
        (CYLINDER + "[rod.loads]\ngravity = [0, 0, -9.81]", "rod.linear_density = None: gravity"),
        (
            CYLINDER + '[rod.support]\nkind = "pivot"\nstiffness = 1',
            "rod.support.stiffness = 1: allowed is three numbers greater than 0",
        ),
        (
            CYLINDER + f'[rod.support]\nkind = "compliant"\nstiffness = {(-np.eye(6)).tolist()}',
            "rod.support.stiffness has the eigenvalue",
        ),
        (
            CYLINDER + '[rod.rest]\nkind = "points"\npoints = [[0, 0, 0], [0, 0, 1]]',
            "rod.rest.points has shape (2, 3); allowed are at least 4 points",
        ),
        (CYLINDER + "temperature = 30", "rod.temperature = 30.0: thermal = None"),
        ('kind = "unit"\ntemperature = 30', "rod.temperature: unknown key"),
        (
            CYLINDER + "temperature = 4000\n[rod.thermal]\nmodulus_slope = -3e-4",
            "rod.temperature = 4000.0: Young's modulus would be -0.194 of that at 20 °C",
        ),
        (
            CYLINDER.replace("cylinder", "tapered").replace("radius", "base_radius")
            + "tip_radius = 0",
            "rod: at its tip the rod is 0 times as thick as at its clamp",
        ),
        ('kind = "tapered"\nlength = 0.05', "rod.base_radius: missing"),
        (
            'kind = "table"\narc_length = [0, 0.02, 0.01]\nradius = [1, 1, 1]\nyoungs_modulus = 1',
            "rod.arc_length[2] = 0.01; allowed is a number greater than 0.02",
        ),
    ],
)
def test_wrong_tables_are_named_in_a_line(tmp_path: Path, table: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        rod(tmp_path, table)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_list_with_a_wrong_entry_is_named_once(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        rod(tmp_path, CYLINDER + "[rod.loads]\ngravity = [nan, 0, -9.81]")
    assert str(caught.value).endswith("rod.loads.gravity[0] = nan: allowed is a finite number")


def test_results_in_netcdf_hold_the_whole_rod(tmp_path: Path) -> None:
    tube = replace(KINDS["a tube"][1], yield_strain=0.01, linear_density=1e-3, thermal=THERMAL)
    sphere = vb.surfaces.Sphere(center=(0, 0, 0.06), radius=0.02)
    scan = vb.scan(tube, sphere, vb.Trail.line(start=(0.03, 0.002, 0), stop=(0, 0.002, 0), count=5))
    z = np.linspace(0, 0.05, 30)
    bow = vb.RestShape.from_points(np.stack([2 * z**2, 0 * z, z], axis=1))
    for described in (tube, tube.curved(bow)):
        data = replace(scan, rod=described).to_dataset()
        vb.io.write_dataset(tmp_path / "scan.nc", data)
        assert read_sweep(tmp_path / "scan.nc").rod == described


def test_functions_of_loads_are_not_read_back() -> None:
    blown = HEAVY.loaded(vb.Loads(gravity=(0, 0, -9.81), wind=lambda p: p))
    assert '"function"' in rod_to_json(blown)
    assert rod_from_json(rod_to_json(blown)) == HEAVY.loaded(vb.Loads(gravity=(0, 0, -9.81)))
