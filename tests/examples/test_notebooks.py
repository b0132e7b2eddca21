"""The notebooks of the docs run as they stand, and print what they show."""

import sys
from pathlib import Path

import nbformat
import pytest

DOCS = Path(__file__).parents[2] / "docs"


def _printed(notebook: nbformat.NotebookNode) -> list[str]:
    return [
        output.text
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if output.output_type == "stream" and output.name == "stdout"
    ]


def _pictures(notebook: nbformat.NotebookNode) -> int:
    return sum(
        "image/png" in output.get("data", {})
        for cell in notebook.cells
        for output in cell.get("outputs", [])
    )


@pytest.mark.parametrize("name", ["design", "without_hardware"])
def test_a_notebook_prints_and_draws_what_it_shows(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    sys.modules.pop("run_tutorials", None)
    from run_tutorials import run

    shown = nbformat.read(DOCS / "tutorials" / f"{name}.ipynb", as_version=4)
    assert _printed(shown)
    again = run(DOCS / "tutorials" / f"{name}.ipynb")
    assert _printed(again) == _printed(shown)
    assert _pictures(again) == _pictures(shown) >= 2
