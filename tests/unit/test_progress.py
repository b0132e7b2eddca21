"""Long computations tell how far they are: `progress(done, total)`, up to the end."""

from pathlib import Path

import numpy as np
import pytest

import vibrissa as vb

EXAMPLES = Path(__file__).parents[2] / "examples"
BALL = EXAMPLES / "recordings/sphere_60mm"


class Told:
    """What was told."""

    def __init__(self) -> None:
        self.done: list[int] = []
        self.total: list[int] = []

    def __call__(self, done: int, total: int) -> None:
        """Note it."""
        self.done.append(done)
        self.total.append(total)

    def assert_complete(self) -> None:
        """Never backwards, never past the total, and all of it in the end."""
        assert self.done == sorted(self.done)
        assert all(0 < done <= total for done, total in zip(self.done, self.total, strict=True))
        assert self.done[-1] == self.total[-1]


def test_scan_tells_of_every_position() -> None:
    case = vb.load_case(EXAMPLES / "cases/steel_wire_sphere.toml")
    told = Told()
    scan = vb.scan(case.rod, case.surface, case.trail, progress=told)
    told.assert_complete()
    assert set(told.total) == {scan.kind.size}
    # After the march of all trails, and after what was followed by hand.
    assert len(told.done) > 1


def test_scan_counts_rows_that_fail_and_those_it_passes_over() -> None:
    ball, told = vb.surfaces.Sphere(center=(0.0, 0.0, 1.15), radius=0.6), Told()
    into = vb.Trail.line(start=(0.0, 0.0, -0.5), stop=(0.0, 0.0, 0.9), count=29)
    scan = vb.scan(vb.Rod.unit(), ball, into, progress=told)
    assert np.any(scan.status == vb.Status.CLAMP_INSIDE)
    assert np.any(scan.status == vb.Status.HEAD_ON)
    told.assert_complete()


def test_calibration_smoothing_and_reading_tell() -> None:
    setup = vb.load_setup(BALL / "setup.toml")
    reactions = vb.read_recording(BALL / "trail.csv", setup)
    told = Told()
    vb.calibrate(reactions, setup, free=["youngs_modulus"], progress=told)
    told.assert_complete()
    assert len(told.done) > 5
    told = Told()
    found = vb.smooth(vb.reconstruct(setup.rod, reactions), progress=told)
    told.assert_complete()
    assert (len(told.done), set(told.total)) == (6, {found.kind.size})


def test_mesh_tells_while_it_is_built(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((0.02, 0.02, 0.02)).export(tmp_path / "box.stl")
    told = Told()
    vb.surfaces.Mesh.load(tmp_path / "box.stl", 1.0, progress=told)
    told.assert_complete()
    case = tmp_path / "case.toml"
    case.write_text(
        '[rod]\nkind = "unit"\n[object]\nkind = "union"\n[[object.parts]]\nkind = "mesh"\n'
        'file = "box.stl"\nscale = 1.0\n[[trail]]\nkind = "line"\nstart = [1.0, 0.0, 0.0]\n'
        "stop = [-1.0, 0.0, 0.0]\ncount = 3\n"
    )
    again = Told()
    vb.load_case(case, progress=again)
    assert again.done == told.done
