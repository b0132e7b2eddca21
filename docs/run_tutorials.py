"""Run the notebooks in docs/tutorials and keep what they print and draw: `python
docs/run_tutorials.py [NAME ...]`.
"""

import sys
from base64 import b64decode, b64encode
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from nbclient import NotebookClient
from PIL import Image

TUTORIALS = Path(__file__).parent / "tutorials"
COLOURS = 256  # a third of the bytes, and no difference that the eye can see


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


def pictures(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    """Data of the outputs that hold a PNG."""
    outputs = (output for cell in notebook.cells for output in cell.get("outputs", []))
    return [output.data for output in outputs if "image/png" in output.get("data", {})]


def _small(png: str) -> str:
    buffer = BytesIO()
    picture = Image.open(BytesIO(b64decode(png))).convert("RGB")
    few = picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(buffer, "PNG", optimize=True)
    return b64encode(buffer.getvalue()).decode()


if __name__ == "__main__":
    for name in sys.argv[1:] or sorted(path.stem for path in TUTORIALS.glob("*.ipynb")):
        made = run(TUTORIALS / f"{name}.ipynb")
        for data in pictures(made):
            data["image/png"] = _small(data["image/png"])
        nbformat.write(made, TUTORIALS / f"{name}.ipynb")
