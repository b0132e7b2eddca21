"""Everything `vibrissa demo` computes and writes."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from vibrissa.forward import Scan, scan
from vibrissa.inverse import Reconstruction, reconstruct
from vibrissa.io import write_dataset
from vibrissa.numerics.progress import Progress
from vibrissa.paper import case
from vibrissa.paper.statements import Statement, statements
from vibrissa.shape import coverage

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COVERED_WITHIN = 0.05
"""Distance [L] within which a contact covers the surface."""


@dataclass(frozen=True)
class Demo:
    """What the demo found and wrote: the paper's sweeps, and what their reactions alone give."""

    scan: Scan
    found: Reconstruction
    statements: list[Statement]
    coverage: dict[str, float]
    files: list[Path]


def run_demo(folder: Path, report: Callable[[str], None], progress: Progress | None = None) -> Demo:
    """The paper, forward and inverse: figures 2, 3a and 3b, the plane case, further sweeps, and the
    table of statements.

    Parameters
    ----------
    folder
        Where figures (PNG, PDF), datasets (NetCDF) and the table (CSV) go; it must exist.
    report
        Called with the name of each step as it begins.
    progress
        As for `scan`.
    """
    swept = partial(scan, case.ROD, case.SURFACE, progress=progress)
    report("forward: eleven trails")
    paper = swept(case.trails())
    report("inverse: contacts from reactions alone")
    found = reconstruct(case.ROD, paper.reactions)
    report("forward: the plane case y0 = 0")
    plane = swept(case.plane_trail())
    report("further sweeps: across the trails, and at other distances")
    further = {name: swept(trail) for name, trail in case.further().items()}
    covered = _covered(found, further)
    checked = statements(paper, plane, found)
    report("datasets")
    datasets: dict[str, Scan | Reconstruction] = {
        "paper_scan": paper,
        "paper_contacts": found,
        "plane_scan": plane,
        **{f"{name}_scan": part for name, part in further.items()},
    }
    files = [
        write_dataset(folder / f"{name}.nc", result.to_dataset())
        for name, result in datasets.items()
    ]
    table = pd.DataFrame(checked)
    table["holds"] = table["holds"].map({True: "yes", False: "no"})
    files.append(folder / "statements.csv")
    table.to_csv(files[-1], index=False)
    files += _figures(folder, report, paper, found, plane, covered)
    return Demo(paper, found, checked, {name: share for name, _, _, share in covered}, files)


def _covered(
    found: Reconstruction, further: dict[str, Scan]
) -> list[tuple[str, np.ndarray, np.ndarray, float]]:
    samples = case.region()
    contacts = np.delete(found.point, case.PLANE, axis=0).reshape(-1, 3)
    cases = []
    for name, more in (
        ("ten trails", ()),
        ("and perpendicular trails", ("perpendicular",)),
        ("and other distances", ("nearer", "farther")),
    ):
        for extra in more:
            # Only positions that pass every check count: a real rod would not be where the others
            # put it.
            again = reconstruct(case.ROD, further[extra].reactions)
            sound = (further[extra].status == 0) & again.in_contact
            contacts = np.vstack([contacts, again.point[sound]])
        share, near = coverage(contacts, samples, COVERED_WITHIN)
        cases.append((name, contacts, near, share))
    return cases


def _figures(
    folder: Path,
    report: Callable[[str], None],
    paper: Scan,
    found: Reconstruction,
    plane: Scan,
    covered: list[tuple[str, np.ndarray, np.ndarray, float]],
) -> list[Path]:
    from vibrissa import plot  # noqa: PLC0415

    shown = tuple(np.flatnonzero(np.isin(np.abs(case.Y0), (0.2, 0.5))).tolist())
    skip = (case.PLANE,)
    others = tuple(k for k in range(len(case.Y0)) if k not in skip)
    drawings: dict[str, Callable[[], Axes | list[Axes]]] = {
        "figure2_reactions": lambda: plot.reactions_over_plane(paper, skip=skip),
        "figure3a_elastic_lines": lambda: plot.scene(
            paper, trails=shown, rods=24, events=False, view=(15, -55)
        ),
        "figure3b_contacts": lambda: plot.scene(
            found, surface=case.SURFACE, trails=others, rods=0, view=(8, -60)
        ),
        "plane_case": lambda: plot.reactions_along(plane),
        "coverage": lambda: plot.coverage_figure(case.region(), covered, within=COVERED_WITHIN),
    }
    files = []
    for name, draw in drawings.items():
        report(f"figure: {name}")
        with plot.journal():
            files += plot.save(draw(), folder, name)
    return files
