"""The page that a browser shows: a scene with its controls, served or saved."""

from __future__ import annotations

import contextlib
import io
import socket
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vibrissa.files import InputError, writable
from vibrissa.libraries import extra_library
from vibrissa.viewer.colours import MODES, By, modes_of
from vibrissa.viewer.content import Content, Fitted
from vibrissa.viewer.html import numbers_html
from vibrissa.viewer.scene import Scene

if TYPE_CHECKING:
    import viser

_REPAINT = 20
"""Instants of a stream after which counts and ranges of the legend are brought up to date."""
_FRAME = 1 / 15
"""Seconds from one instant to the next while playing: a sweep takes some fifteen seconds."""


def serve(host: str, port: int) -> viser.ViserServer:
    """Start a server for browsers: the port is the next free one if it is taken.

    Raises
    ------
    ImportError
        If viser is not installed.
    OSError
        If the address cannot be used.
    """
    # viser would wait forever for a server at an address that is not of this machine.
    socket.create_server((host, 0)).close()
    library = extra_library("viser", extra="view", need="the viewer needs it")
    # It prints its address in a box; standard output may belong to a sink.
    with contextlib.redirect_stdout(io.StringIO()):
        server: viser.ViserServer = library.ViserServer(host, port, "vibrissa", verbose=False)
    # Sharing would send the scene to a server elsewhere.
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    return server


def address(server: viser.ViserServer) -> str:
    """Where a browser finds a server."""
    return f"http://{server.get_host()}:{server.get_port()}"


def stop(server: viser.ViserServer) -> None:
    """Stop a server, which would say so on standard output."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


class Viewer:
    """A page with the object, the rods and the contacts of one or more results.

    Made by `vibrissa.view`. It is served by a thread of this process until `close`, or the end of a
    `with` block.

    Attributes
    ----------
    url
        Address to open in a browser.
    """

    def __init__(
        self, server: viser.ViserServer, content: Content, colour: By, *, growing: bool = False
    ) -> None:
        self.content, self._server, self.url = content, server, address(server)
        self._closed = threading.Event()
        self.scene = Scene(server, content, colour)
        self._panel = Panel(server, self.scene, content, colour, growing=growing)
        threading.Thread(target=self._run, name="viewer", daemon=True).start()

    @property
    def instant(self) -> int:
        """Which position of the time slider is shown, from 0."""
        return self.scene.shown

    @property
    def cameras(self) -> list[viser.CameraHandle]:
        """From where each browser looks, once it has said so."""
        cameras = [client.camera for client in self._server.get_clients().values()]
        return [camera for camera in cameras if camera.update_timestamp > 0]

    def show(self, instant: int) -> None:
        """Move the time slider.

        Raises
        ------
        ValueError
            If there is no such position.
        """
        count = len(self.scene.instants)
        if not 0 <= instant < count:
            raise ValueError(f"instant = {instant}; allowed are 0 to {count - 1}")
        self._panel.move(instant)

    def play(self) -> None:
        """Play the sweep from its beginning."""
        self._panel.play()

    def grew(self) -> None:
        """The scene has other instants: adapt the time slider, and show the newest one if the
        slider was at its end.
        """
        self._panel.grew()

    def refit(self, fitted: Fitted) -> None:
        """Show another fitted surface."""
        self.scene.refit([fitted])
        self._panel.refitted()

    def wait(self) -> None:
        """Return when the page is closed, or on Ctrl-C."""
        with contextlib.suppress(KeyboardInterrupt):
            self._closed.wait()

    def close(self) -> None:
        """Stop serving the page."""
        self._closed.set()
        stop(self._server)

    def __enter__(self) -> Viewer:
        """Return the viewer."""
        return self

    def __exit__(self, *_: object) -> None:
        """Stop serving the page."""
        self.close()

    def _run(self) -> None:
        while not self._closed.wait(_FRAME):
            self._panel.step()

    def save(self, path: str | Path) -> Path:
        """Write the page as one HTML file that needs neither this program nor a network: it plays
        the sweep, with a slider.

        Raises
        ------
        InputError
            If the suffix is not .html, or the file cannot be written.
        """
        file = page_file(path)
        scene, shown = self.scene, self.scene.shown
        scene.show(0)
        serializer = self._server.get_scene_serializer()
        for number in range(1, len(scene.instants)):
            serializer.insert_sleep(_FRAME)
            scene.show(number)
        if len(scene.instants) > 1:
            serializer.insert_sleep(15 * _FRAME)
        page = serializer.as_html()
        scene.show(shown)
        # Below viser's own button.
        place = "position:fixed;top:54px;right:12px;max-width:45vw;padding:6px 2px;"
        look = "background:#ffffffd8;border-radius:6px;font-family:sans-serif"
        end = page.rindex("</body>")
        overlay = f"<div class='legend' style='{place}{look}'>{scene.legend}</div>"
        page = page[:end] + overlay + page[end:]
        file.write_text(page, encoding="utf-8")
        return file


def page_file(path: str | Path) -> Path:
    """Return the path; raise InputError unless it ends in .html and can be written."""
    file = Path(path)
    if file.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{file}: suffix {file.suffix!r}; allowed is .html")
    return writable(file)


class Panel:
    """Controls: time slider and play button, colours, what is shown, the numbers of a contact."""

    def __init__(
        self,
        server: viser.ViserServer,
        scene: Scene,
        content: Content,
        colour: By,
        *,
        growing: bool,
    ) -> None:
        self._scene, self._content, self._gui = scene, content, server.gui
        self._playing = False
        self._slider: Any = None
        self._label: Any = None
        if len(scene.instants) > 1:
            self._add_time()
        with self._gui.add_folder("Colours"):
            modes = MODES if growing else modes_of(content)
            self._by = self._gui.add_dropdown("by", modes, initial_value=colour)
            self._legend = self._gui.add_html(scene.legend)
        self._by.on_update(lambda _: self._recolour())
        if len(content.triangles):
            self._add_switch(server, "object")
        if growing or content.fitted:
            self._add_switch(server, "surface")
        if growing or "uncertainty" in modes:
            self._add_switch(server, "ellipsoids")
        if growing or len(content.contacts):
            with self._gui.add_folder("Contact"):
                self._numbers = self._gui.add_html(numbers_html(None, content))
            server.scene.on_click()(self._pick)

    def _add_time(self) -> None:
        last = len(self._scene.instants) - 1
        with self._gui.add_folder("Sweep"):
            self._slider = self._gui.add_slider("instant", 0, last, 1, last)
            self._label = self._gui.add_markdown("")
            self._button = self._gui.add_button("Play")
        self._slider.on_update(lambda _: self._moved())
        self._button.on_click(lambda _: self._toggle())
        self._moved()

    def _add_switch(self, server: viser.ViserServer, name: str) -> None:
        box = self._gui.add_checkbox(name, initial_value=True)

        @box.on_update
        def _(_: object) -> None:
            # Looked up anew: a stream replaces its nodes from time to time.
            handle = server.scene.get_handle_by_name(f"/{name}")
            assert handle is not None
            handle.visible = box.value

    def _moved(self) -> None:
        number = int(self._slider.value)
        self._scene.show(number)
        self._label.content = self._scene.instants[number].label

    def move(self, number: int) -> None:
        """Move the slider."""
        if self._slider is None:
            return
        self._slider.value = number
        self._moved()

    def _toggle(self) -> None:
        if self._playing:
            self._stop()
        elif self._slider.value >= self._slider.max:
            self.play()
        else:
            self._start()

    def play(self) -> None:
        """Play from the beginning."""
        if self._slider is not None:
            self.move(0)
            self._start()

    def _start(self) -> None:
        self._playing, self._button.label = True, "Pause"

    def _stop(self) -> None:
        self._playing, self._button.label = False, "Play"

    def step(self) -> None:
        """Go on by one instant if playing; stop at the last."""
        if not self._playing:
            return
        self.move(min(self._slider.value + 1, self._slider.max))
        if self._slider.value >= self._slider.max:
            self._stop()

    def grew(self) -> None:
        """Adapt to other instants; what is shown last stays last."""
        slider, last = self._slider, len(self._scene.instants) - 1
        follows = slider.value >= slider.max and not self._playing
        slider.max = last
        if follows or slider.value > last:
            self.move(last)
        if last % _REPAINT == 0:
            self._recolour()

    def refitted(self) -> None:
        """Let the legend say what the colours of another surface mean."""
        self._legend.content = self._scene.legend

    def _recolour(self) -> None:
        self._scene.recolour(self._by.value)
        self._legend.content = self._scene.legend

    def _pick(self, event: Any) -> None:
        ray = np.array(event.ray_origin), np.array(event.ray_direction)
        rows = self._scene.picked(*ray)
        self._scene.mark(rows)
        self._numbers.content = numbers_html(rows, self._content)


def checked_colour(colour: str, content: Content) -> By:
    """Return what contacts are coloured by; raise InputError unless it is known of them."""
    allowed = modes_of(content)
    for by in allowed:
        if colour == by:
            return by
    known = colour in MODES
    raise InputError(
        f"colour = {colour!r}{' is not known of these contacts' if known else ''}; "
        f"allowed are {', '.join(allowed)}"
    )
