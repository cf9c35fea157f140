"""Pages of a study on this machine, by viser: one for each browser that opens it."""

import errno
import io
import json
import os
import socket
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from torcharm.extras import extra
from torcharm.page.state import State
from torcharm.page.view import View
from torcharm.plot._common import array

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Names of this machine that no other one reaches."""
GRID = 0.1
"""Width of a cell of the grid behind arms [m], of which ten are a section; behind small ones it is a tenth of that."""
PORTS = 100
"""That are tried, from the one asked for on."""
FAREWELL = 0.3
"""For browsers to hear that the server ends [s]."""


class Server:
    """Serves pages of a study until it is stopped; each browser has one of its own, which ends with it.

    Args:
        state: with which each page begins.
        out: the one file that pages write and read.
        host: the address to listen at.
        port: the port, or a free one after it if it is taken; 0 takes any.

    Raises:
        ValueError: viser is not installed, the host is no address of this machine, or no port is free.
    """

    def __init__(self, state: State, out: Path, host: str = LOOPBACK[0], port: int = 8080) -> None:
        viser = extra("viser", "explore")
        port = _free_port(host, port)

        # No page may ask viser to have a server elsewhere forward it to the world.
        local = type("Local", (viser.ViserServer,), {"request_share_url": lambda *_, **__: None})
        with redirect_stdout(io.StringIO()):  # the command says where the page is
            self._server: Any = local(host, port, label=state.study.name, verbose=False)
        self._viser, self._host, self._state, self._out = viser, host, state, out
        self.views: dict[int, View] = {}
        self._prepare()

    @property
    def url(self) -> str:
        """Where a browser on this machine finds the page."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{'localhost' if self._host in ('0.0.0.0', '::') else host}:{self.port}"

    @property
    def port(self) -> int:
        """At which it listens."""
        return int(self._server.get_port())

    def stop(self) -> None:
        """End all pages, which say so, and the server."""
        views = tuple(self.views.values())
        for view in views:
            view.end()
        time.sleep(FAREWELL if views else 0.0)
        with redirect_stdout(io.StringIO()):
            self._server.stop()
        for view in tuple(self.views.values()):  # one opened meanwhile would not let the process end
            view.session.close()

    def _prepare(self) -> None:
        """What all pages share, and what happens when one comes and goes."""
        server = self._server
        server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        # As viser sends its library of plots: it has no other way to give a page a title that is not "Viser".
        title = json.dumps(f"{self._state.study.name} – torcharm")
        script = self._viser._messages.RunJavascriptMessage(f"document.title = {title}")
        server._websock_server.queue_message(script)
        server.scene.set_up_direction("+y")
        server.scene.world_axes.visible = False
        length = float(array(self._state.named_arm.design.neutral_length))
        cell = GRID if length > 0.2 else GRID / 10
        server.scene.add_grid(
            "/grid",
            40.0 * length,
            40.0 * length,
            plane="xy",
            position=(0.0, 0.0, -length),
            cell_size=cell,
            section_size=10 * cell,
            cell_color=(225, 225, 225),
            section_color=(190, 190, 190),
            fade_distance=12.0 * length,
        )

        server.on_client_connect(self._opened)
        server.on_client_disconnect(self._closed)

    async def _opened(self, client: Any) -> None:
        if self._from_here(client):
            self.views[client.client_id] = View(client, self._viser, self._state, self._out)

    async def _closed(self, client: Any) -> None:
        view = self.views.pop(client.client_id, None)
        if view is not None:
            view.session.close()

    def _from_here(self, client: Any) -> bool:
        """Whether a page is this server's own, and not one of another site that the same browser shows.

        A browser lets any site open a connection to this machine, and says in `Origin` which did.
        """
        connection = self._server._websock_server._live_connections.get(client.client_id)
        request = getattr(connection, "request", None)
        headers = {} if request is None else request.headers
        origin = headers.get("Origin")
        if origin is None:  # no browser
            return True
        return own_origin(origin, headers.get("Host", ""), self._host)


def own_origin(origin: str, asked: str, host: str) -> bool:
    """Whether a page is one of a server's own.

    Args:
        origin: of the page, such as http://localhost:8080.
        asked: the host and port that the browser asked for.
        host: at which the server listens.
    """
    try:
        page = urlsplit(origin)
        name = page.hostname
    except ValueError:
        return False
    if host in LOOPBACK:  # a name that someone else has let point here is none of these
        return name in LOOPBACK
    return page.netloc == asked


def _free_port(host: str, port: int) -> int:
    """The port, or the next that nothing listens at; viser would look for ever where the host or all ports are none."""
    why = ""
    for tried in range(port, min(port + PORTS, 1 << 16)):
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, tried, type=socket.SOCK_STREAM)[0]
            with socket.socket(family, kind, protocol) as listening:
                if os.name == "posix":  # as viser does, whom ports that were in use a moment ago do not hinder
                    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listening.bind(address)
            return tried
        except OSError as error:
            why = error.strerror or str(error)
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise ValueError(f"--host: must be an address of this machine, got {host} ({why})") from None
            if error.errno == errno.EACCES:
                break
    raise ValueError(f"--port: must be one at which this machine may listen, got {port} ({why})")
