"""Draw README's and the front page's pictures: `uv run python docs/make_pictures.py`."""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import vibrissa as vb

IMAGES = Path(__file__).parent / "images"
CASE = vb.load_case(Path(__file__).parents[1] / "examples" / "cases" / "paper.toml")
SHOWN = (1, 3, 7, 9)
"""The trails y0 = ±0.2 and ±0.4."""


def main() -> None:
    """The sweep of the paper as rods, as contacts found again, and as a film."""
    scan = vb.scan(CASE.rod, CASE.surface, CASE.trail)
    found = vb.reconstruct(CASE.rod, scan.reactions)
    others = [k for k in range(len(scan.kind)) if k != len(scan.kind) // 2]
    with vb.plot.journal():
        mpl.rcParams["savefig.dpi"] = 180
        lines = vb.plot.scene(scan, trails=SHOWN, events=False)
        vb.plot.save_as(lines, IMAGES / "elastic_lines.png")
        points = vb.plot.scene(found, surface=CASE.surface, trails=others, rods=0)
        vb.plot.save_as(points, IMAGES / "contacts.png")
        vb.plot.animation(scan, IMAGES / "sweep.webp", trails=SHOWN, seconds=6)


if __name__ == "__main__":
    main()
