"""Sphinx configuration: the documentation builds, and reads, without a network."""

import ast
import json
import re
import tomllib
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

import vibrissa
from vibrissa.contacts import ContactKind, Status
from vibrissa.forward import EventKind

# Sphinx 9 deprecates what its own napoleon and the MyST parser still do.
warnings.filterwarnings(
    "ignore", message="The mapping interface for autodoc options objects is deprecated"
)
warnings.filterwarnings("ignore", message="'myst_parser")

ROOT = Path(__file__).parent.parent

project = "vibrissa"
author = "The vibrissa developers"
copyright = "The vibrissa developers, Apache-2.0"
version = release = vibrissa.__version__

extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "myst_nb"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "vibrissa"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["math.css", "pages.css"]

autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False
napoleon_use_rtype = False

myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 3
# These answer browsers only.
linkcheck_ignore = [r"https://(www\.mdpi\.com|pmc\.ncbi\.nlm\.nih\.gov)/.*"]
nb_execution_mode = "off"  # outputs are stored: docs/run_tutorials.py


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def _status_table() -> str:
    """Every `Status`, with the sentence that the code itself gives."""
    rows = [(str(int(status)), f"`{status.name}`", status.text) for status in Status]
    return _table(("", "status", "what it means, and what to do"), rows)


def _rooms_table() -> str:
    """The rooms from top to bottom, as import-linter's contract holds them, with the first line of
    each one's docstring.
    """
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "importlinter"
    ]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    rows = []
    for level, layer in enumerate(layers, start=1):
        for room in (name.strip() for name in layer.replace(":", "|").split("|")):
            said = ast.get_docstring(ast.parse(_source(room))) or ""
            first = said.split("\n\n")[0].replace("\n", " ")
            rows.append((str(level), f"`{room}`", first))
    return _table(("", "room", "what it holds"), rows)


def _source(room: str) -> str:
    folder = ROOT / "src" / "vibrissa" / room
    file = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    return file.read_text(encoding="utf-8")


def _names(enumeration: type[ContactKind] | type[EventKind]) -> str:
    return ", ".join(f"`{member.name}` {int(member)}" for member in enumeration)


def _measured(name: str) -> dict[str, Any]:
    numbers = json.loads((Path(__file__).parent / f"{name}.json").read_text(encoding="utf-8"))
    return dict(numbers)


def _accuracy() -> dict[str, str]:
    """What docs/make_accuracy.py measured."""
    numbers = _measured("accuracy")
    head = ("recording", "contacts", "median, raw [mm]", "95 % of them below [mm]")
    head += ("inside 95 % ellipsoids [%]", "median, smoothed [mm]", "95 % below [mm]", "inside [%]")
    table = _table(head, [tuple(row) for row in numbers.pop("recordings")])
    return {name: str(value) for name, value in numbers.items()} | {"recordings_table": table}


_EFFECTS = {
    "wind": "wind across [m/s], sensor tared without it",
    "tared_wind": "wind across [m/s], sensor tared in it",
    "weight": "weight of a level wire, by its diameter [mm], tared",
    "temperature": "warmer than calibrated [K]",
    "support": "the support turns [mrad per N mm]",
    "taper": "tip thinner [%]",
    "curvature": "tip off the straight line at rest [mm], tared",
}


def _real_rods() -> dict[str, str]:
    """What docs/make_real_rods.py measured."""
    numbers = _measured("real_rods")
    head = ("what is ignored", "size", "median error [% of L]", "largest [% of L]")
    head += ("rows not OK [%]", "warned")
    rows = [
        (
            _EFFECTS[name] if number == 0 else "",
            f"{row['size']:g}",
            f"{row['median']:.2g}",
            f"{row['largest']:.2g}",
            f"{100 * row['marked']:.0f}",
            "yes" if row["warnings"] else "no",
        )
        for name, found in numbers.items()
        for number, row in enumerate(found)
    ]
    worst = max(row["corrected"] for found in numbers.values() for row in found)
    return {"real_rods_table": _table(head, rows), "real_rods_corrected": f"{worst / 100:.0e}"}


VALUES: dict[str, str] = {
    name: str(value)
    for name, value in (
        _accuracy()
        | _measured("comparison")
        | _real_rods()
        | {
            "contact_kinds": _names(ContactKind),
            "event_kinds": _names(EventKind),
            "rooms_table": _rooms_table(),
            "status_table": _status_table(),
        }
    ).items()
}
"""What `fill.py` writes into the pages."""


def _inline_math(translator: Any, node: nodes.math) -> None:
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def _block_math(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def _names_together(
    _app: Any, _what: str, _name: str, _object: object, _options: object, lines: list[str]
) -> None:
    """Keep names that share one description ("point, normal") together: napoleon takes all but the
    last for a type.
    """
    for index, (line, following) in enumerate(pairwise(lines)):
        if re.fullmatch(r"\w+(, \w+)+", line) and following.startswith("    "):
            lines[index] = line.replace(", ", ",\u200b")


def _property_in_one(
    _app: Any, what: str, _name: str, _object: object, _options: object, lines: list[str]
) -> None:
    """Undo what napoleon does to a property: it takes what stands before a colon for a type."""
    types = [line for line in lines if line.startswith(":type: ")]
    if what == "property" and types:
        lines.remove(types[0])
        lines[0] = f"{types[0].removeprefix(':type: ')}: {lines[0]}"


def setup(app: Any) -> None:
    """Render formulas as MathML, which browsers show by themselves, so that no script has to be
    fetched; mend docstrings around napoleon.
    """
    app.add_html_math_renderer(
        "mathml", inline_renderers=(_inline_math, None), block_renderers=(_block_math, None)
    )
    app.connect("autodoc-process-docstring", _names_together, priority=400)
    app.connect("autodoc-process-docstring", _property_in_one, priority=600)
