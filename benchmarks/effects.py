"""What error bars cover, and what is reported, if something deviates from the setup: `python
benchmarks/effects.py [--only NAME ...] [-o TABLE.md]`.

The recordings come from independent engines, with the truth: those beside the checkout, and those
of `bench_recordings.py`, which are made if missing (`--made FOLDER`; three minutes). Each is
reconstructed and smoothed without tolerances (`--tolerances none`), with a tolerance for what is
off, as large as it is off (`own`, if there is such a tolerance), and with the usual ones of a
careful bench (`usual`). `--reference TABLE.csv` compares the noise's share of the error bars with
an earlier run of this program. A row that fails says why.
"""

import argparse
import csv
import gzip
import os
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

import vibrissa as vb

SHARED = Path(__file__).parents[1].parent / "shared" / "recordings"
CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "vibrissa-benchmarks"

USUAL = """youngs_modulus = 0.04
radius = 0.01
length = 0.4e-3
clamp_position = 0.4e-3
clamp_orientation = 0.01
gain = 0.015
pose_delay = 5e-3
"""
"""Those of a careful bench: the example in the documentation of the table."""

_SHORT = 90
_GROSS, _FAR = 1.0, 5.0
"""A contact farther than this from the truth [mm], and by more than so many standard deviations, is
a gross outlier.
"""

SHARED_EFFECTS = {
    "clamp1deg_y": ("clamp turned about y", "1°", "clamp_orientation = 0.0175"),
    "pose_late50ms": ("poses late", "50 ms", "pose_delay = 0.05"),
    "gain_all2pc": ("all channels read too much", "2 %", "gain = 0.02"),
    "drift_fx1mN_s": ("zero of fx drifts", "1 mN/s", ""),
    "taper5": ("radius at the tip smaller", "50 %", ""),
    "sagy": ("sagitta sideways", "1 mm", ""),
    "fast30": ("30 mm/s, with inertia", "", ""),
}


class Case(NamedTuple):
    """A recording; its truth: contacts (n, 3), NaN where there is none; the setup's text; what is
    off, by how much, and the line of [tolerances] that allows for it.
    """

    name: str
    recording: Path
    setup: str
    point: np.ndarray
    effect: str
    size: str
    tolerance: str


@dataclass
class Row:
    """A line of the table: medians of error and stated deviation [mm]; shares [%] of the true
    contacts that were found; the first warnings.
    """

    name: str
    effect: str
    size: str
    tolerances: str
    error: float = np.nan
    deviation: float = np.nan
    noise: float = np.nan
    noise_ratio: float = np.nan
    inside: float = np.nan
    inside_ok: float = np.nan
    ok: float = np.nan
    missed: float = np.nan
    gross: float = np.nan
    seconds: float = np.nan
    said: str = ""


def cases(only: list[str], made: Path, scratch: Path) -> Iterator[Case]:
    """All recordings, or those named."""
    for path in sorted((SHARED / "effects").glob("*.csv.gz")):
        name = path.name.removesuffix(".csv.gz")
        if only and name not in only:
            continue
        (scratch / f"{name}.csv").write_bytes(gzip.decompress(path.read_bytes()))
        truth = np.load(path.with_name(f"{name}.truth.npz"))
        point = np.where(truth["ic"][:, None], truth["p"], np.nan)
        setup = path.with_name(f"{name}.toml").read_text()
        yield Case(
            name, scratch / f"{name}.csv", setup, point, *SHARED_EFFECTS.get(name, ("none", "", ""))
        )
    for path in sorted((SHARED / "sphere_60mm").glob("*/*.truth.csv")):
        name = f"{path.parent.name}/{path.name.removesuffix('.truth.csv')}"
        if not only or name in only:
            table = np.genfromtxt(path, delimiter=",", names=True)
            point = np.where(
                table["in_contact"][:, None] == 1,
                np.stack([table[axis] for axis in "xyz"], axis=1),
                np.nan,
            )
            setup = (SHARED / "sphere_60mm" / "setup.toml").read_text()
            yield Case(
                name, path.with_name(path.name.replace(".truth", "")), setup, point, "none", "", ""
            )
    yield from _made(only, made)


def _made(only: list[str], folder: Path) -> Iterator[Case]:
    try:
        from bench_recordings import RECORDINGS, made, seed_of  # noqa: PLC0415
    except ImportError as error:
        print(f"no recordings of our own: {error} (dependency group `benchmark`)")
        return
    for name, recording in RECORDINGS.items():
        if only and name not in only:
            continue
        if not (folder / f"{name}.truth.npz").exists():
            made(recording, folder / "runs", seed_of(name)).write(folder, name)
        truth = np.load(folder / f"{name}.truth.npz")
        setup = (folder / f"{name}.toml").read_text()
        yield Case(
            name,
            folder / f"{name}.csv",
            setup,
            truth["p"],
            recording.effect,
            recording.size,
            recording.tolerance,
        )


def row_of(case: Case, label: str, tolerances: str, scratch: Path) -> Row:
    """Reconstruct and smooth one recording with the tolerances given as TOML; a failure is noted in
    the row.
    """
    row = Row(case.name, case.effect, case.size, label)
    file = scratch / "setup.toml"
    file.write_text(case.setup + (f"\n[tolerances]\n{tolerances}\n" if tolerances else ""))
    begin = perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            setup = vb.load_setup(file)
            found = vb.reconstruct(setup.rod, vb.read_recording(case.recording, setup))
            smooth = vb.smooth(found)
        except Exception as error:
            row.said = f"{type(error).__name__}: {error}".replace("\n", " ")[:_SHORT]
            return row
    row.seconds = perf_counter() - begin
    said = [*getattr(smooth, "warnings", ()), *getattr(found, "warnings", ())]
    said += [str(one.message) for one in caught if issubclass(one.category, vb.RecordingWarning)]
    said = list(dict.fromkeys(said))
    row.said = " | ".join(" ".join(line.split())[:_SHORT] for line in said[:3]) + (
        f" (+{len(said) - 3})" if len(said) > 3 else ""
    )
    judge(row, smooth, case.point)
    return row


def judge(row: Row, found: vb.Reconstruction, truth: np.ndarray) -> None:
    """Compare with the truth where both are in contact."""
    true = np.isfinite(truth[:, 0])
    rows = true & found.in_contact & np.isfinite(found.point[:, 0])
    row.missed = 100 * float(np.mean(~rows[true]))
    if not rows.any():
        row.said = f"no contact found. {row.said}"
        return
    error = found.point[rows] - truth[rows]
    covariance = found.covariance[rows]
    finite = np.all(np.isfinite(covariance), axis=(1, 2))
    square = np.full(len(error), np.inf)
    square[finite] = np.einsum(
        "ni,nij,nj->n",
        error[finite],
        np.linalg.pinv(covariance[finite], hermitian=True),
        error[finite],
    )
    ok = found.status[rows] == vb.Status.OK
    inside, distance = square < chi2.isf(0.05, 3), 1e3 * np.linalg.norm(error, axis=1)
    row.error, row.deviation = float(np.median(distance)), _largest(covariance[finite])
    noise = getattr(found, "covariance_noise", None)
    row.noise = _largest((found.covariance if noise is None else noise)[rows][finite])
    row.inside, row.ok = 100 * float(np.mean(inside)), 100 * float(np.mean(ok))
    row.inside_ok = 100 * float(np.mean(inside[ok])) if ok.any() else np.nan
    row.gross = 100 * float(np.mean(ok & (distance > _GROSS) & (square > _FAR**2)))


def _largest(covariance: np.ndarray) -> float:
    """Median standard deviation along the longest axis [mm]."""
    return 1e3 * float(np.sqrt(np.median(np.linalg.eigvalsh(covariance)[:, -1])))


def compare(rows: list[Row], reference: Path) -> None:
    """Fill in the noise's deviation over that of the same recording, without tolerances, in an
    earlier table.
    """
    with reference.open(newline="") as file:
        before = {
            line["name"]: float(line["noise"])
            for line in csv.DictReader(file)
            if line["tolerances"] == "none"
        }
    for row in rows:
        row.noise_ratio = row.noise / before.get(row.name, np.nan)


def as_markdown(rows: list[Row]) -> str:
    """The table."""
    heads = (
        "name | effect | size | tolerances | error, mm | stated, mm | noise alone | over reference | "
        "inside, % | inside, OK rows, % | OK, % | missed, % | gross, % | s | said"
    )
    lines = [f"| {heads} |", "|" + "---|" * (heads.count("|") + 1)]
    places = (3, 3, 3, 2, 0, 0, 0, 0, 1, 1)
    for row in rows:
        values = list(asdict(row).values())
        numbers = [
            "" if np.isnan(value) else f"{value:.{digits}f}"
            for value, digits in zip(values[4:-1], places, strict=True)
        ]
        lines.append(
            "| " + " | ".join([*values[:4], *numbers, values[-1].replace("|", "·")]) + " |"
        )
    return "\n".join(lines) + "\n"


def write(rows: list[Row], path: Path) -> None:
    """Write the table: CSV if the suffix says so, else Markdown."""
    if path.suffix != ".csv":
        path.write_text(as_markdown(rows))
        return
    with path.open("w", newline="") as file:
        out = csv.DictWriter(file, [field.name for field in fields(Row)])
        out.writeheader()
        out.writerows(map(asdict, rows))


def main(
    only: list[str], tolerances: list[str], made: Path, output: list[Path], reference: Path | None
) -> list[Row]:
    """Print lines as they come; write and return the table."""
    rows: list[Row] = []
    with TemporaryDirectory() as folder:
        for case in cases(only, made, Path(folder)):
            texts = {"none": "", "own": case.tolerance, "usual": USUAL}
            for label in tolerances:
                if label == "own" and not case.tolerance:
                    continue
                rows.append(row_of(case, label, texts[label], Path(folder)))
                if reference is not None:
                    compare(rows[-1:], reference)
                print(as_markdown(rows[-1:]).splitlines()[-1], flush=True)
                for path in output:
                    write(rows, path)
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME")
    parser.add_argument(
        "--tolerances",
        nargs="+",
        choices=("none", "own", "usual"),
        default=["none", "own", "usual"],
    )
    parser.add_argument(
        "--made", type=Path, default=CACHE, metavar="FOLDER", help="for the recordings made here"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        nargs="+",
        default=[],
        metavar="TABLE",
        help="Markdown, or CSV by its suffix",
    )
    parser.add_argument("--reference", type=Path, metavar="TABLE.csv")
    given = parser.parse_args()
    main(given.only, given.tolerances, given.made, given.output, given.reference)
