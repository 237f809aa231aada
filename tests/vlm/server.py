"""A local server that speaks enough of the chat-completions protocol, well or badly."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

Handler = Callable[["Exchange"], None]


class Exchange:
    """One request: its body, and ways to answer it."""

    def __init__(self, http: BaseHTTPRequestHandler, body: dict[str, Any], number: int) -> None:
        self.http, self.body, self.number = http, body, number
        self.key = http.headers.get("Authorization", "")

    def say(self, content: str | None, status: int = 200) -> None:
        """Answer with a message."""
        message = {"role": "assistant", "content": content}
        self.send(
            {
                "id": "1",
                "object": "chat.completion",
                "created": 0,
                "model": self.body["model"],
                "choices": [{"index": 0, "message": message, "finish_reason": "stop"}],
                "usage": {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110},
            },
            status,
        )

    def send(self, body: Any, status: int = 200) -> None:
        """Answer with any JSON."""
        self.raw(json.dumps(body).encode(), status)

    def raw(self, data: bytes, status: int = 200, promised: int | None = None) -> None:
        """Answer with bytes, and possibly promise more of them."""
        self.http.send_response(status)
        self.http.send_header("Content-Type", "application/json")
        self.http.send_header("Content-Length", str(len(data) if promised is None else promised))
        self.http.end_headers()
        self.http.wfile.write(data)

    def drip(self, seconds: float) -> None:
        """Send a byte now and then."""
        self.raw(b"", promised=10_000)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.http.wfile.write(b" ")
            self.http.wfile.flush()
            time.sleep(0.05)


@contextmanager
def serving(handler: Handler) -> Iterator[tuple[str, list[Exchange]]]:
    """Serve until the block ends; yield the base URL and the list of what was asked."""
    seen: list[Exchange] = []

    class Http(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            exchange = Exchange(self, body, len(seen))
            seen.append(exchange)
            with suppress(BrokenPipeError, ConnectionResetError):  # the client has had enough
                handler(exchange)

        def log_message(self, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Http)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/v1", seen
    finally:
        server.shutdown()
        server.server_close()
