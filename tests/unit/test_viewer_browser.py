"""The viewer in headless Chromium: the page loads, the slider moves the rod, a click shows numbers,
and a saved page does the same from a file, without a network.
"""

import io
import shutil
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vibrissa as vb
from vibrissa.drawing import KIND_COLOURS
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.viewer import Viewer
from vibrissa.viewer.colours import rgb

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SIZE = {"width": 900, "height": 600}
PATIENCE = 180.0  # [s]: a browser that draws in software, on a busy machine
if CHROMIUM is None:
    pytest.skip("no Chromium is installed", allow_module_level=True)
playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed: uv sync --group browser"
)
image = pytest.importorskip("PIL.Image")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        flags = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        opened = started.chromium.launch(executable_path=CHROMIUM, args=[*flags, "--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    rod = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
    sphere = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
    trail = vb.Trail.line(start=(0.04, 0.005, 0), stop=(-0.04, 0.005, 0), count=41)
    with vb.view(vb.scan(rod, sphere, trail), port=8280) as made:
        yield made


@pytest.fixture(scope="module")
def page(browser: Any, viewer: Viewer) -> Iterator[Any]:
    opened = browser.new_page(viewport=SIZE)
    errors: list[str] = []
    opened.on("pageerror", lambda error: errors.append(str(error)))
    opened.goto(viewer.url)
    opened.wait_for_selector("canvas")
    wait_for(lambda: len(viewer.cameras) == 1 and drawn(opened).std() > 10)
    yield opened
    assert errors == []
    opened.close()


def wait_for(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.2)


def drawn(page: Any) -> np.ndarray:
    """The page as pixels (rows, columns, 3)."""
    return np.asarray(image.open(io.BytesIO(page.screenshot())).convert("RGB")).astype(float)


def seen_at(viewer: Viewer, point: np.ndarray) -> tuple[int, int]:
    """Column and row of the pixel where a point of the scene is seen."""
    (camera,) = viewer.cameras
    right, down, forward = rotation_matrices(np.asarray(camera.wxyz)[[1, 2, 3, 0]]).T
    away = point - camera.position
    scale = SIZE["height"] / 2 / np.tan(camera.fov / 2) / (away @ forward)
    across, up = away @ right * scale, away @ down * scale
    return round(SIZE["width"] / 2 + across), round(SIZE["height"] / 2 + up)


def shows(page: Any, place: tuple[int, int], colour: str) -> bool:
    """Whether a colour is seen within two pixels of a place."""
    column, row = place
    around = drawn(page)[row - 2 : row + 3, column - 2 : column + 3]
    return bool((np.abs(around - rgb(colour)).max(axis=-1) < 40).any())


def test_the_slider_moves_the_rod(page: Any, viewer: Viewer) -> None:
    instants = viewer.content.instants

    def bent(number: int) -> tuple[str, tuple[int, int]]:
        """Colour of a rod, and where a piece near its clamp is seen."""
        (colour,) = instants[number].rods.keys() & set(KIND_COLOURS.values())
        return colour, seen_at(viewer, instants[number].rods[colour][4].mean(axis=0))

    viewer.show(15)
    wait_for(lambda: shows(page, bent(15)[1], bent(15)[0]))
    assert not shows(page, bent(25)[1], bent(25)[0])
    page.get_by_role("slider").first.focus()
    for _ in range(10):
        page.keyboard.press("ArrowRight")
    wait_for(lambda: viewer.instant == 25)
    wait_for(lambda: shows(page, bent(25)[1], bent(25)[0]))
    assert not shows(page, bent(15)[1], bent(15)[0])
    assert page.get_by_text("position 26 of 41").is_visible()


def test_play_goes_on_to_the_end(page: Any, viewer: Viewer) -> None:
    viewer.show(36)
    page.get_by_role("button", name="Play").click()
    wait_for(lambda: viewer.instant == 40)
    wait_for(lambda: page.get_by_role("button", name="Play").is_visible())


def test_a_click_on_a_contact_shows_its_numbers(page: Any, viewer: Viewer) -> None:
    viewer.show(40)
    contacts = viewer.content.contacts
    facing = contacts.normal @ (viewer.cameras[0].position - contacts.point[0])
    row = int(np.argmax(facing))
    page.mouse.click(*seen_at(viewer, contacts.point[row]))
    page.get_by_text("support force").wait_for(timeout=1e3 * PATIENCE)
    said = page.get_by_role("table").inner_text()
    # Whichever of those that touch each other on the screen lies in front.
    points = [", ".join(f"{value:.4g}" for value in point) for point in contacts.point]
    shown = [point for point in points if point in said]
    assert len(shown) == 1
    assert np.linalg.norm(contacts.point[points.index(shown[0])] - contacts.point[row]) < 2.0


def test_colours_change_with_their_legend(page: Any, viewer: Viewer) -> None:
    page.locator("input[value=kind]").first.click()
    page.get_by_role("option", name="force").click()
    page.get_by_text("support force [N]").wait_for(timeout=1e3 * PATIENCE)
    assert viewer.scene.painter.legend.title == "support force [N]"


def test_a_saved_page_plays_from_a_file(browser: Any, viewer: Viewer, tmp_path: Path) -> None:
    file = viewer.save(tmp_path / "scene.html")
    assert 5e5 < file.stat().st_size < 5e6
    context = browser.new_context(viewport={"width": 700, "height": 560}, offline=True)
    saved, asked = context.new_page(), []
    saved.on("request", lambda request: asked.append(request.url))
    saved.goto(file.as_uri())
    saved.wait_for_selector("canvas")
    assert saved.get_by_text("tangential contact", exact=False).first.is_visible()
    # Nothing lies over a corner of the legend.
    free = """legend => { const {left, right, top, bottom} = legend.getBoundingClientRect();
        return [[left, top], [right, top], [left, bottom], [right, bottom]].every(([x, y]) =>
            legend.contains(document.elementFromPoint(x + (x == left ? 6 : -6),
                                                      y + (y == top ? 6 : -6)))) }"""
    assert saved.locator(".legend").evaluate(free)
    bar = saved.locator(".mantine-Slider-track").first
    bar.wait_for(timeout=1e3 * PATIENCE)
    box = bar.bounding_box()
    before = np.zeros_like(drawn(saved))
    for share in (0.3, 0.6):
        # It pauses where it is put.
        saved.mouse.click(box["x"] + share * box["width"], box["y"] + box["height"] / 2)
        # The rod is a hundred pixels long, and drawn at two places.
        wait_for(partial(shows_another_rod, saved, before))
        before = drawn(saved)
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    context.close()


def is_still(page: Any) -> bool:
    """Whether nothing moves for a second."""
    before = drawn(page)
    time.sleep(1)
    return bool((before == drawn(page)).all())


def shows_another_rod(page: Any, before: np.ndarray) -> bool:
    """Whether the page stands still above its slider, and not as it was."""
    changed = (drawn(page) != before).any(axis=-1)[50:480].sum()
    return changed > 100 and coloured(page) > 20 and is_still(page)


def coloured(page: Any) -> int:
    """Number of pixels in the colours of contacts and bent rods."""
    pixels = drawn(page)[:, :500]
    near = [np.abs(pixels - rgb(colour)).max(axis=-1) < 40 for colour in KIND_COLOURS.values()]
    return int(np.logical_or(*near).sum())
