"""The house keeps its own rules: lint, types, import contracts, one version."""

import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def _run(*command: str) -> str:
    result = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    output = result.stdout + result.stderr
    assert result.returncode == 0, output[-4000:]
    return output


@pytest.mark.parametrize(
    "command", [("ruff", "check", "."), ("ruff", "format", "--check", ".")], ids=["lint", "format"]
)
def test_style(command: tuple[str, ...]) -> None:
    _run(*command)


def test_types() -> None:
    stubs = {
        name: tuple(map(int, version(name).split(".")[:2])) for name in ("numpy", "matplotlib")
    }
    if stubs["numpy"] < (2, 4) or stubs["matplotlib"] < (3, 11):
        pytest.skip(
            f"types are checked against the stubs of NumPy 2.4 and Matplotlib 3.11 or later; here are {stubs}"
        )
    assert "no issues found" in _run("mypy")


def test_rooms_import_only_from_below() -> None:
    script = "from importlinter.cli import lint_imports; raise SystemExit(lint_imports())"
    result = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout[-4000:]
    assert "3 kept, 0 broken" in result.stdout


def test_the_inverse_loads_without_the_object() -> None:
    # Independent of the import contract: the modules that are really loaded.
    script = "import sys, vibrissa.inverse; bad = [m for m in sys.modules if m.startswith(('vibrissa.surfaces', 'vibrissa.forward'))]; assert not bad, bad"
    result = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr[-2000:]


def test_the_command_line_loads_nothing_heavy() -> None:
    script = (
        "import sys, vibrissa, vibrissa.cli; bad = [m for m in ('jax', 'numpy', 'scipy', 'xarray', 'matplotlib', 'pydantic') if m in sys.modules]; "
        "assert not bad, bad"
    )
    result = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr[-2000:]


def test_versions_agree() -> None:
    import vibrissa

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert vibrissa.__version__ == project["version"]
    assert f"version: {project['version']}" in (ROOT / "CITATION.cff").read_text(
        encoding="utf-8"
    ).replace('"', "")
