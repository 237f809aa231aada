"""A local server that speaks enough of the chat-completions protocol, well or badly."""

from __future__ import annotations

import json
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

Handler = Callable[["Exchange"], None]
CERTIFICATE = Path(__file__).parent / "localhost.pem"
"""A self-signed certificate of 127.0.0.1 and its key; trusted by nobody but these tests."""
DRIP_S = 0.03
"""Pause between two drips [s], far below any timeout."""


def completion(content: Any, usage: Any = None) -> dict[str, Any]:
    """Return a chat completion with a text."""
    return {
        "id": "1",
        "object": "chat.completion",
        "created": 0,
        "model": "tiny",
        "choices": [{"index": 0, "message": {"role": "assistant", "content": content}, "finish_reason": "stop"}],
        "usage": usage or {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110},
    }


class Exchange:
    """One request: its body, and ways to answer it."""

    def __init__(self, http: BaseHTTPRequestHandler, body: dict[str, Any], number: int) -> None:
        self.http, self.body, self.number = http, body, number
        self.key = http.headers.get("Authorization", "")

    def say(self, content: Any, status: int = 200, usage: Any = None) -> None:
        """Answer with a message."""
        self.send(completion(content, usage), status)

    def send(self, body: Any, status: int = 200) -> None:
        """Answer with any JSON."""
        self.raw(json.dumps(body).encode(), status)

    def raw(self, data: bytes, status: int = 200, promised: int | None = None, headers: Any = ()) -> None:
        """Answer with bytes, and possibly promise more of them."""
        self.http.send_response(status)
        self.http.send_header("Content-Type", "application/json")
        self.http.send_header("Content-Length", str(len(data) if promised is None else promised))
        for name, value in headers:
            self.http.send_header(name, value)
        self.http.end_headers()
        self.write(data)

    def write(self, data: bytes) -> None:
        """Send bytes as they are, without any HTTP."""
        self.http.wfile.write(data)
        self.http.wfile.flush()

    def drip(self, piece: bytes, seconds: float = 5.0) -> None:
        """Send a piece every `DRIP_S` until the client has gone."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.write(piece)
            time.sleep(DRIP_S)

    def flood(self, piece: bytes, size: int = 64 << 20) -> None:
        """Send a piece as often as the client accepts it, up to ``size`` bytes."""
        block = piece * (1 + (64 << 10) // len(piece))
        for _ in range(size // len(block)):
            self.write(block)


@contextmanager
def serving(handler: Handler, tls: bool = False) -> Iterator[tuple[str, list[Exchange]]]:
    """Serve until the block ends; yield the base URL and the list of the requests so far."""
    seen: list[Exchange] = []

    class Http(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            exchange = Exchange(self, body, len(seen))
            seen.append(exchange)
            with suppress(OSError):  # the client has had enough
                handler(exchange)
            self.close_connection = True

        def log_message(self, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Http)
    server.handle_error = lambda *_: None
    if tls:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(CERTIFICATE)
        server.socket = context.wrap_socket(server.socket, server_side=True)
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
    try:
        yield f"{'https' if tls else 'http'}://127.0.0.1:{server.server_address[1]}/v1", seen
    finally:
        server.shutdown()
        server.server_close()


@contextmanager
def listening(handler: Callable[[socket.socket], None]) -> Iterator[int]:
    """Give every TCP connection to ``handler``, unread; yield the port."""
    server = socket.create_server(("127.0.0.1", 0))

    def accept() -> None:
        with suppress(OSError):
            while True:
                threading.Thread(target=handle, args=(server.accept()[0],), daemon=True).start()

    def handle(connection: socket.socket) -> None:
        with suppress(OSError), connection:
            handler(connection)

    threading.Thread(target=accept, daemon=True).start()
    try:
        yield server.getsockname()[1]
    finally:
        server.shutdown(socket.SHUT_RDWR)  # wakes the accepting thread
        server.close()
