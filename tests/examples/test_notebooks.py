"""The notebooks of the docs run as they stand, and print and draw what they show."""

import re
import sys
from pathlib import Path
from types import ModuleType

import nbformat
import pytest

DOCS = Path(__file__).parents[2] / "docs"
NUMBER = re.compile(r"\d+(?:\.(\d+))?")
CLOSE = 0.05
"""Share by which printed numbers may differ from machine to machine: another processor rounds in
another order, and samples in noise then fall to the other side of a threshold.
"""


@pytest.fixture
def tutorials(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(DOCS))
    sys.modules.pop("run_tutorials", None)
    import run_tutorials

    return run_tutorials


def _printed(notebook: nbformat.NotebookNode) -> list[str]:
    return [
        output.text
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if output.output_type == "stream" and output.name == "stdout"
    ]


def _assert_alike(ours: str, theirs: str) -> None:
    """The same words, and numbers within `CLOSE` or one of their last digit."""
    assert NUMBER.sub("#", ours).split() == NUMBER.sub("#", theirs).split()
    for one, other in zip(NUMBER.finditer(ours), NUMBER.finditer(theirs), strict=True):
        digit = 10.0 ** -len(one[1] or "")
        assert float(one[0]) == pytest.approx(float(other[0]), rel=CLOSE, abs=1.001 * digit)


@pytest.mark.parametrize("name", [path.stem for path in sorted(DOCS.glob("tutorials/*.ipynb"))])
def test_a_notebook_prints_and_draws_what_it_shows(name: str, tutorials: ModuleType) -> None:
    shown = nbformat.read(DOCS / "tutorials" / f"{name}.ipynb", as_version=4)
    again = tutorials.run(DOCS / "tutorials" / f"{name}.ipynb")
    printed = _printed(again), _printed(shown)
    assert printed[1]
    for ours, theirs in zip(*printed, strict=True):
        _assert_alike(ours, theirs)
    # One picture for each cell that draws, shown and drawn anew, none of them empty.
    drawing = sum("with vb.plot.journal" in cell.source for cell in shown.cells)
    for notebook in (shown, again):
        made = tutorials.pictures(notebook)
        assert len(made) == drawing > 0
        assert min(len(data["image/png"]) for data in made) > 5_000
