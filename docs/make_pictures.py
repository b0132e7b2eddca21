"""Draw the pictures of README, the front page and other pages: `uv run python docs/make_pictures.py
[NAME ...]` writes them into docs/images. Gallery, diagrams, notebooks and measured pages have
scripts of their own.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

from matplotlib.axes import Axes

import vibrissa as vb
from vibrissa.io import inspect_recording
from vibrissa.plot import journal, save_as
from vibrissa.sensor import preset

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
CASE = vb.load_case(ROOT / "examples" / "cases" / "paper.toml")
SHOWN = (1, 3, 7, 9)
"""The trails y0 = ±0.2 and ±0.4."""
RECORDING = ROOT / "examples" / "recordings" / "sphere_60mm"

VIEW = (15.0, -55.0)
"""From where one sees the inside of the bowl, too."""
Panels = Axes | list[Axes]


def elastic_lines() -> Panels:
    """The paper's sweep."""
    return vb.plot.scene(_scan(), trails=SHOWN, events=False, view=VIEW)


def contacts() -> Panels:
    """Its contacts, found again from the reactions."""
    scan = _scan()
    others = [k for k in range(len(scan.kind)) if k != len(scan.kind) // 2]
    found = vb.reconstruct(CASE.rod, scan.reactions)
    return vb.plot.scene(found, surface=CASE.surface, trails=others, rods=0, view=VIEW)


def sweep() -> None:
    """It moves."""
    vb.plot.animation(_scan(), IMAGES / "sweep.webp", trails=SHOWN, seconds=6, view=VIEW)


def _scan() -> vb.Scan:
    return vb.scan(CASE.rod, CASE.surface, CASE.trail)


def guide() -> Panels:
    """The guide's first sweep: the paper's bowl at y0 = 0.2."""
    bowl = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
    line = vb.Trail.line(start=(1.2, 0.2, 0), stop=(-1.2, 0.2, 0), count=241)
    return vb.plot.scene(vb.scan(vb.Rod.unit(), bowl, line), rods=24)


def recorded() -> Panels:
    """What `vibrissa reconstruct --figure` draws of the shipped recording."""
    return vb.plot.contacts_figure(_found())


def smoothed() -> Panels:
    """The same, smoothed."""
    return vb.plot.contacts_figure(vb.smooth(_found()))


def inspection() -> Panels:
    """What `vibrissa inspect --figure` draws of the shipped recording."""
    setup = vb.load_setup(RECORDING / "setup.toml")
    return vb.plot.recording_figure(inspect_recording(RECORDING / "trail.csv", setup), setup.sensor)


def expected() -> Panels:
    """The sensor page's scene, but for the trail in its plane of symmetry."""
    wire = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
    ball = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
    lines = vb.Trail.raster(
        start=(0.04, -0.018, 0), stop=(-0.04, -0.018, 0), count=121, step=(0, 0.004, 0), trails=10
    )
    sensor = preset("ati_nano17_si_12_0_12", clamp_position=(0, 0, 0.025))
    return vb.plot.expected_error_map(vb.expected_error(wire, ball, lines, sensor, samples=10))


def _found() -> vb.Reconstruction:
    setup = vb.load_setup(RECORDING / "setup.toml")
    return vb.reconstruct(setup.rod, vb.read_recording(RECORDING / "trail.csv", setup))


DRAWN: dict[str, Callable[[], Panels | None]] = {
    drawing.__name__: drawing
    for drawing in (
        *(elastic_lines, contacts, sweep),
        *(guide, recorded, smoothed, inspection, expected),
    )
}
FRONT = ("elastic_lines", "contacts")
"""Pictures of README and the front page, which lie beside the animation."""


def main(names: list[str]) -> None:
    """Draw these, or all."""
    for name in names or DRAWN:
        with journal():
            mpl.rcParams["savefig.dpi"] = 180
            panels = DRAWN[name]()
            if panels is not None:
                save_as(panels, IMAGES / ("" if name in FRONT else "pages") / f"{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
