"""A page served to browsers on this machine or, if asked to, to others: the page itself, and news as they come.

Nothing of a page's motion is asked of the server: a page holds all frames of its story and draws them itself.
"""

import json
import socket
import threading
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from regrasp.errors import InputError
from regrasp.view.page import page

PORT = 8080
PATIENCE = 15.0
"""s after which a line that says nothing tells a silent connection from a dead one."""


class Server:
    """A context in which a packed story (`story.pack`) is served; `story` and `news` tell the pages that are open.

    port: None for 8080, or any free one where that is taken; 0: any free one. Raises InputError if the address can't be
    had.
    """

    def __init__(self, packed: bytes, host: str = "127.0.0.1", port: int | None = None) -> None:
        self._packed, self._told = packed, threading.Condition()
        self._news: dict[str, tuple[int, str]] = {}
        self._count, self._ended = 0, False
        self._http = _listening(host, port, _handler(self))
        self._http.daemon_threads = True

    def __enter__(self) -> "Server":
        threading.Thread(target=self._http.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._told:
            self._ended = True
            self._told.notify_all()
        self._http.shutdown()
        self._http.server_close()

    @property
    def url(self) -> str:
        """Where the page is."""
        host, port = self._http.server_address[:2]
        name = str(host)
        return f"http://{f'[{name}]' if ':' in name else name}:{port}/"

    def story(self, packed: bytes) -> None:
        """Serve another story from now on; open pages change over to it."""
        self._packed = packed
        self.news("story", {})

    def news(self, kind: str, content: Mapping[str, Any]) -> None:
        """Tell all pages, those that are opened later too; the latest of each kind is what counts."""
        with self._told:
            self._count += 1
            self._news[kind] = (self._count, json.dumps({"kind": kind, **content}, allow_nan=False))
            self._told.notify_all()

    def since(self, seen: int) -> tuple[int, list[str]]:
        """What is newer than news number `seen`, oldest first, and the number of the last; waits for it."""
        with self._told:
            self._told.wait_for(lambda: self._count > seen or self._ended, PATIENCE)
            fresh = sorted(each for each in self._news.values() if each[0] > seen)
            return max(self._count, seen), [text for _, text in fresh]

    def __call__(self, request: BaseHTTPRequestHandler) -> None:
        """Answer a request: the page, its story alone, the news as server-sent events."""
        if request.path == "/":
            _answer(request, "text/html; charset=utf-8", page(self._packed, live=True).encode())
        elif request.path == "/story":
            _answer(request, "application/octet-stream", self._packed)
        elif request.path == "/news":
            request.send_response(HTTPStatus.OK)
            request.send_header("Content-Type", "text/event-stream")
            request.send_header("Cache-Control", "no-store")
            request.end_headers()
            seen = 0
            while not self._ended:
                seen, fresh = self.since(seen)
                lines = "".join(f"data: {text}\n\n" for text in fresh) or ": still there\n\n"
                request.wfile.write(lines.encode())
                request.wfile.flush()
        else:
            request.send_error(HTTPStatus.NOT_FOUND)


def local(host: str) -> bool:
    """Whether only this machine reaches an address."""
    return host in ("127.0.0.1", "localhost", "::1")


def _answer(request: BaseHTTPRequestHandler, kind: str, body: bytes) -> None:
    request.send_response(HTTPStatus.OK)
    request.send_header("Content-Type", kind)
    request.send_header("Content-Length", str(len(body)))
    request.send_header("Cache-Control", "no-store")
    request.end_headers()
    request.wfile.write(body)


def _handler(server: Server) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            try:
                server(self)
            except ConnectionError:
                self.close_connection = True  # the page was closed

        def log_message(self, format: str, *args: object) -> None:
            pass

    return Handler


def _listening(host: str, port: int | None, handler: type[BaseHTTPRequestHandler]) -> ThreadingHTTPServer:
    class Listening(ThreadingHTTPServer):
        address_family = socket.AF_INET6 if ":" in host else socket.AF_INET

    for each in (PORT, 0) if port is None else (port,):
        try:
            return Listening((host, each), handler)
        except OSError as error:
            last = error
        except OverflowError:
            raise InputError("--port", f"is {each}", "0 to 65535") from None
    raise InputError("--host, --port", f"cannot listen on {host}:{port}: {last.strerror}", "another one") from None
