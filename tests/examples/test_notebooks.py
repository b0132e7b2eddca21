"""The notebooks of the docs run as they stand, and print and draw what they show."""

import sys
from pathlib import Path
from types import ModuleType

import nbformat
import pytest

DOCS = Path(__file__).parents[2] / "docs"


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


@pytest.mark.parametrize("name", [path.stem for path in sorted(DOCS.glob("tutorials/*.ipynb"))])
def test_a_notebook_prints_and_draws_what_it_shows(name: str, tutorials: ModuleType) -> None:
    shown = nbformat.read(DOCS / "tutorials" / f"{name}.ipynb", as_version=4)
    again = tutorials.run(DOCS / "tutorials" / f"{name}.ipynb")
    assert _printed(again) == _printed(shown) != []
    # One picture for each cell that draws, shown and drawn anew, none of them empty.
    drawing = sum("with vb.plot.journal" in cell.source for cell in shown.cells)
    for notebook in (shown, again):
        made = tutorials.pictures(notebook)
        assert len(made) == drawing > 0
        assert min(len(data["image/png"]) for data in made) > 5_000
