"""The code on pages runs as it stands, from top to bottom, and prints what the page says. Those of
the guide and of the sensor take minutes, and are not run here.
"""

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_BLOCK = re.compile(r"^```(python|text|toml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_FILE = re.compile(r"# (\w+\.toml)\n")


def _differences(page: str) -> list[str]:
    """Run the code of a page in the current folder, with the files that it shows, and compare its
    output block by block.
    """
    names: dict[str, object] = {"__name__": page}
    printed: str | None = None
    wrong = []
    for kind, body in _BLOCK.findall((ROOT / "docs" / page).read_text(encoding="utf-8")):
        if kind == "toml" and (named := _FILE.match(body)):
            Path(named[1]).write_text(body, encoding="utf-8")
        elif kind == "python":
            output = StringIO()
            with redirect_stdout(output):
                exec(compile(body, page, "exec"), names)
            printed = output.getvalue()
        elif kind == "text" and printed is not None:
            if printed != body:
                wrong.append(f"the page says:\n{body}it prints:\n{printed}")
            printed = None
    return wrong


@pytest.mark.parametrize("page", ["live.md"])
def test_what_a_page_prints(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # What a page takes from a checkout lies beside it.
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    assert _differences(page) == []
