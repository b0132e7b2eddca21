"""The bench that `vibrissa example bench` hands out, and the tutorial on it, as printed."""

import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from command_line import status_of, vibrissa
from pages import blocks_of, commands_of

import vibrissa as vb

DOCS = Path(__file__).parents[2] / "docs"


def test_the_tutorial_runs_and_says_what_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every command and every line of Python, in an empty folder; then the files it leaves."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "tutorial"}
    said, warned = "", ""
    for kind, body in blocks_of(DOCS / "tutorials/bench.md"):
        if kind == "sh":
            runs = [vibrissa(capsys, *words) for words in commands_of(body)]
            assert [run.status for run in runs] == [0] * len(runs), runs
            said, warned = (
                "".join(run.out for run in runs),
                warned + "".join(run.err for run in runs),
            )
        elif kind == "python":
            with redirect_stdout(StringIO()) as output:
                exec(compile(body, "bench.md", "exec"), names)
            said = output.getvalue()
        elif kind == "toml":
            assert body in Path("bench/setup.toml").read_text(encoding="utf-8")
        else:
            assert set(body.splitlines()) <= set(said.splitlines()), said
    assert "0.82 % higher" in warned and "off by 0.15 mm in the median" in warned
    _check(tmp_path)


def _check(folder: Path) -> None:
    """The calibration finds the truth in README, and all files hold the same contacts."""
    setup = vb.load_setup(folder / "bench/calibrated.toml")
    assert setup.rod.length == pytest.approx(0.05, abs=1e-4)
    assert setup.rod.bending_stiffness == pytest.approx(206e9 * np.pi / 4 * 0.25e-3**4, rel=0.005)
    assert setup.sensor.clamp_position[2] == pytest.approx(0.025, abs=7e-5)
    first, second = (vb.load_setup(folder / f"bench/{name}.toml") for name in ("first", "setup"))
    assert first.rod.length == second.rod.length and first.sensor.wrench == second.sensor.wrench
    np.testing.assert_array_equal(first.sensor.clamp_position, second.sensor.clamp_position)
    cloud = vb.read_contacts(folder / "out/bar_2.csv")
    there = cloud.kind != 0
    for suffix in ("vtp", "mat", "mcap"):
        other = vb.read_contacts(folder / f"out/bar_2.{suffix}")
        points = other.point[other.kind != 0]
        np.testing.assert_allclose(points, cloud.point[there], rtol=1e-6)
    log = vb.io.read_raw(folder / "bench/bar_2.csv", setup).raw
    for copy in ("bar_2_bag", "bar_2_log.mat"):
        fitting = folder / f"out/{copy.removesuffix('.mat')}_setup.toml"
        again = vb.io.read_raw(folder / "out" / copy, vb.load_setup(fitting)).raw
        np.testing.assert_allclose(again.wrench, log.wrench, rtol=1e-12)
    assert (folder / "out/scene.png").stat().st_size > 20_000


def test_examples_are_listed_and_never_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    listed = vibrissa(capsys, "example").out.splitlines()
    # What does not fit goes on in an indented line.
    heads = [line.split() for line in listed if not line.startswith(" ")]
    names = [head[0] for head in heads]
    assert names[0] == "bench" and "mug" in names and all(len(head) > 3 for head in heads)
    assert status_of("example", "mug", "-o", tmp_path) == 0
    assert vb.load_case(tmp_path / "mug.toml").rod.length > 0
    again = vibrissa(capsys, "example", "mug", "-o", tmp_path)
    assert again.status == 2 and "mug.toml exists already" in again.err
    assert "allowed are bench" in vibrissa(capsys, "example", "cup").err


def test_diagrams_show_what_the_package_computes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Signs, torques and the flange, as the tutorial says."""
    monkeypatch.syspath_prepend(str(DOCS))
    sys.modules.pop("make_frames", None)
    import make_frames

    found = make_frames.bench()
    assert found.readings["on_sensor"][[0, 2]].round(2).tolist() == [0.32, -0.26]
    points = [[0, 0, 0], [0, 0, 0.016], make_frames.CLAMP]
    torques = [1e3 * make_frames.torque_about(found, np.array(point))[1] for point in points]
    assert np.round(torques, 1).tolist() == [26.1, 20.9, 18.1]
    # The flange's frame in place of the sensor's, 22 mm below: the same reactions.
    own = vb.sensor.Sensor(make_frames.CLAMP, (0, 0, 0, 1), "on_sensor")
    flange = vb.sensor.Sensor(
        make_frames.CLAMP + [0, 0, 0.022], (0, 0, 0, 1), "on_sensor", wrench_point=(0, 0, 0.022)
    )
    still = np.array([[0.0, 0.6, 0.0, 0.8]])
    np.testing.assert_allclose(own.to_reactions(still), flange.to_reactions(still), atol=1e-15)
