"""Run the notebooks in docs/tutorials and keep what they print and draw: `python
docs/run_tutorials.py [NAME ...]`.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from nbclient import NotebookClient

TUTORIALS = Path(__file__).parent / "tutorials"


def run(path: Path) -> nbformat.NotebookNode:
    """The notebook with fresh outputs; what it writes goes to an empty folder."""
    notebook = nbformat.read(path, as_version=4)
    with TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook,
            timeout=300,
            kernel_name="python3",
            record_timing=False,
            coalesce_streams=True,
            resources={"metadata": {"path": folder}},
        )
        client.execute()
    return notebook


if __name__ == "__main__":
    for name in sys.argv[1:] or sorted(path.stem for path in TUTORIALS.glob("*.ipynb")):
        nbformat.write(run(TUTORIALS / f"{name}.ipynb"), TUTORIALS / f"{name}.ipynb")
