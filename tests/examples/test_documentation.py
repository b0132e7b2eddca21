"""Every code block of README and docs runs as it stands, from top to bottom of its page, and prints
what the page says.

Python is executed, commands are run in this process, TOML has to be a setup or a case. All of a
page's blocks share one folder, in which the checkout's examples lie.
"""

import re
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from command_line import status_of
from pages import blocks_of, commands_of

import vibrissa as vb

ROOT = Path(__file__).parents[2]
_FILE = re.compile(r"# (\w+\.toml)\n")
_SETUP = """
[rod]
kind = "cylinder"
length = 0.05
radius = 0.25e-3
youngs_modulus = 206e9
[sensor]
clamp_position = [0, 0, 0]
clamp_orientation = [0, 0, 0, 1]
wrench = "on_rod"
"""
"""What a table needs around it to be part of a setup."""
_LONG = ("demo", "live", "simulate-sensor")
"""Commands that take more than seconds; they need no block before them."""
_MANY_KINDS = ("README.md", "docs/guide.md")
"""Pages whose objects take a minute to compile for."""


def _blocks(page: str) -> list[tuple[str, str]]:
    return blocks_of(ROOT / page)


PAGES = [
    page
    for page in [
        "README.md",
        *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md"))),
    ]
    if any(kind != "text" for kind, _ in _blocks(page))
]


def _plain(text: str) -> str:
    """Without the sign of a zero, which is rounding, and the blanks that make room for it."""
    unsigned = re.sub(r"-0\.(?=[\s\]])", "0.", text)
    return re.sub(r"\[ ", "[", re.sub(r" +", " ", unsigned))


def _differences(page: str) -> list[str]:
    """Run the blocks of a page in the current folder, and compare what they print."""
    names: dict[str, object] = {"__name__": page}
    before, printed, wrong = "", "", []
    for kind, body in [*_blocks(page), ("end", "")]:
        shown = body if kind == "text" else ""
        if before == "python" and _plain(shown) != _plain(printed):
            wrong.append(f"the page says:\n{shown}it prints:\n{printed}")
        before = kind
        if kind == "toml":
            named = _FILE.match(body)
            file = Path(named[1] if named else "table.toml")
            file.write_text(body if "[rod]" in body else _SETUP + body, encoding="utf-8")
            (vb.load_case if "[[trail]]" in body else vb.load_setup)(file)
        elif kind == "python":
            with redirect_stdout(StringIO()) as output:
                exec(compile(body, page, "exec"), names)
            printed = output.getvalue()
        elif kind == "sh":
            for words in commands_of(body):
                if words[0] not in _LONG:
                    assert status_of(*words) == 0, words
        else:
            assert kind in ("text", "end"), f"{page}: a block of {kind} would not be run"
    return wrong


@pytest.fixture
def beside_the_examples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in, but for what a page takes from a checkout."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    return tmp_path


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.slow] if page in _MANY_KINDS else []) for page in PAGES],
)
@pytest.mark.usefixtures("beside_the_examples")
def test_what_a_page_prints(page: str) -> None:
    assert _differences(page) == []


@pytest.mark.slow
def test_readme_writes_into_one_folder_and_can_be_run_again(
    beside_the_examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    commands = [
        words
        for kind, body in _blocks("README.md")
        if kind == "sh"
        for words in commands_of(body)
        if words[0] not in ("live", "simulate-sensor")
    ]
    assert len(commands) >= 6
    for words in [*commands, *commands]:
        assert status_of(*words) == 0, words
        out = capsys.readouterr().out.splitlines()
        assert not any(line.startswith(("{", "[")) for line in out)
        # The last line says what was written, which is there.
        assert " → out/" in out[-1]
        assert all(Path(file).exists() for file in out[-1].rpartition(" → ")[2].split(", "))
    assert {path.name for path in beside_the_examples.iterdir()} == {"examples", "out"}


def _long(*names: str) -> list[list[str]]:
    return [
        words
        for page in PAGES
        for kind, body in _blocks(page)
        if kind == "sh"
        for words in commands_of(body)
        if words[0] in names
    ]


@pytest.mark.slow
@pytest.mark.parametrize("words", _long("demo"), ids=" ".join)
def test_the_demo(words: list[str], beside_the_examples: Path) -> None:
    assert status_of(*words) == 0
    assert list(beside_the_examples.rglob("demo/statements.csv"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("simulate", "live"),
    list(zip(_long("simulate-sensor"), _long("live"), strict=True)),
    ids=" ".join,
)
def test_a_sensor_simulated_in_one_terminal_is_heard_in_another(
    simulate: list[str], live: list[str], beside_the_examples: Path
) -> None:
    """For as long as the page says, on the ports that it names."""
    other = subprocess.Popen(
        [sys.executable, "-c", "from vibrissa.cli import main; main()", *simulate]
    )
    try:
        assert status_of(*live) == 0
    finally:
        other.terminate()
        other.wait(60)
    sinks = list(beside_the_examples.glob("out/contacts.*"))
    assert sinks
    for sink in sinks:
        assert sink.stat().st_size > 10_000
