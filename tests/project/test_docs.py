"""The documentation builds without warnings; its links, anchors and pictures resolve, every page
has a picture, and every public name is in it.
"""

import re
import socket
import subprocess
import sys
from functools import cache
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

import pytest
from sphinx.util.inventory import InventoryFile

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
ROOMS = ("surfaces", "plot", "io", "io.rosbag", "live", "sensor", "inverse", "calibration")
ROOMS += ("design", "shape", "forward", "paper", "viewer")
PAGES = [
    path.relative_to(DOCS).with_suffix("").as_posix()
    for path in sorted([*DOCS.glob("*.md"), *DOCS.glob("tutorials/*.*")])
]
FOR_DEVELOPERS = ("rooms", "walk")


class Page(HTMLParser):
    """What a built page links to, what it can be linked to at, and its pictures."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.pictures: list[tuple[str, str]] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:  # noqa: D102
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given["id"]} if "id" in given else set()
        if tag in ("a", "link") and "href" in given:
            self.links.append(given["href"])
        if tag == "script" and "src" in given:
            self.links.append(given["src"])
        if tag == "img":
            self.links.append(given["src"])
            self.pictures.append((given["src"], given.get("alt", "")))


class Site(NamedTuple):
    """The built documentation."""

    folder: Path
    pages: dict[Path, Page]


def _build(builder: str, folder: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", builder, DOCS, folder],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, (result.stdout + result.stderr)[-4000:]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder = tmp_path_factory.mktemp("html")
    _build("html", folder)
    return Site(folder, {path: Page(path) for path in folder.rglob("*.html")})


@pytest.mark.parametrize("page", sorted(DOCS.glob("**/*.md")), ids=lambda page: page.stem)
def test_pages_hold_the_values_that_were_measured(
    page: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    text = page.read_text(encoding="utf-8")
    assert import_module("fill").filled(text) == text
    assert "{{" not in text


def test_every_page_is_built(site: Site) -> None:
    for name in PAGES:
        assert site.folder / f"{name}.html" in site.pages, name


def test_links_anchors_and_pictures_resolve(site: Site) -> None:
    dead = []
    for path, page in site.pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            known = site.pages.get(target)
            if not target.exists() or (
                known and parts.fragment and parts.fragment not in known.anchors
            ):
                dead.append(f"{path.relative_to(site.folder)}: {link}")
    assert dead == []


@pytest.mark.slow
def test_external_links_resolve(tmp_path: Path) -> None:
    try:
        socket.create_connection(("docs.scipy.org", 443), timeout=5).close()
    except OSError:
        pytest.skip("no network")
    _build("linkcheck", tmp_path)


def test_every_room_is_in_the_map(site: Site) -> None:
    text = (site.folder / "rooms.html").read_text(encoding="utf-8")
    for folder in (ROOT / "src" / "vibrissa").glob("*/__init__.py"):
        assert f'<span class="pre">{folder.parent.name}</span>' in text


@pytest.mark.parametrize("name", PAGES)
def test_a_page_has_pictures_that_say_what_they_show(name: str, site: Site) -> None:
    pictures = site.pages[site.folder / f"{name}.html"].pictures
    assert pictures
    for source, alt in pictures:
        assert len(alt) > 10 and alt not in source, (source, alt)


def test_every_public_name_is_documented(site: Site) -> None:
    inventory = InventoryFile.loads((site.folder / "objects.inv").read_bytes(), uri="")
    documented = {name for kind in inventory.data.values() for name in kind}
    homes = ("vibrissa", *(f"vibrissa.{room}" for room in ROOMS))
    names = {name for home in homes for name in getattr(import_module(home), "__all__", ())}
    # Where a name has several homes, one of them is enough.
    assert [
        name
        for name in sorted(names - {*ROOMS, "__version__"})
        if not {f"{home}.{name}" for home in homes} & documented
    ] == []


@cache
def _prose(page: Path) -> str:
    return re.sub(r"```.*?```|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.parametrize(
    "page",
    [ROOT / "README.md", *(DOCS / f"{name}.md" for name in PAGES if name not in FOR_DEVELOPERS)],
    ids=lambda path: path.stem,
)
def test_users_are_spared_the_names_of_the_architecture(page: Path) -> None:
    page = page if page.exists() else page.with_suffix(".ipynb")
    assert (
        re.findall(r"(?i)\b(?:rooms?|house)\b(?!/)", _prose(page).replace("spare room", "")) == []
    )


def test_links_of_the_readme_lead_somewhere() -> None:
    for link in re.findall(r"\]\(([^)#]+)", (ROOT / "README.md").read_text(encoding="utf-8")):
        assert urlsplit(link).scheme or (ROOT / link).exists(), link
