"""Draw the pictures of docs/tutorials/bench.md: `uv run python docs/make_bench.py` runs the page in
an empty folder and keeps its figures in docs/images/bench.
"""

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent / "tests" / "unit"))

from pages import blocks_of, commands_of  # noqa: E402

FIGURES = {
    "scene.png": "scene.png",
    "expected.png": "expected.png",
    "inspected.png": "inspected.png",
    "calibration/residuals_over_force.png": "residuals.png",
    "bar_1.png": "bar_1.png",
}
COLOURS = 256  # a third of the bytes, and no difference that the eye can see
_COMMAND = [sys.executable, "-c", "from vibrissa.cli import main; main()"]


def main() -> None:
    """Run the page, then copy what it drew."""
    names: dict[str, object] = {}
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        for kind, body in blocks_of(DOCS / "tutorials" / "bench.md"):
            if kind == "python":
                exec(compile(body, "bench.md", "exec"), names)
            elif kind == "sh":
                for words in commands_of(body):
                    subprocess.run([*_COMMAND, *words], check=True)
        for source, name in FIGURES.items():
            picture = Image.open(Path("out") / source).convert("RGB").quantize(COLOURS)
            picture.save(DOCS / "images" / "bench" / name, optimize=True)
        os.chdir(DOCS)


if __name__ == "__main__":
    main()
