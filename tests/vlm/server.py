"""A local server that speaks enough of the chat-completions protocol, well or badly."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler
from typing import Any

from tests.tools import served

Handler = Callable[["Exchange"], None]


class Exchange:
    """One request: its body, and ways to answer it."""

    def __init__(self, http: BaseHTTPRequestHandler, body: dict[str, Any], number: int) -> None:
        self.http = http
        self.body = body
        self.number = number
        self.key = http.headers.get("Authorization", "")

    def say(self, content: Any) -> None:
        """Answer with a chat completion of a text."""
        message = {
            "index": 0,
            "message": {"role": "assistant", "content": content},
            "finish_reason": "stop",
        }
        usage = {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110}
        head = {"id": "1", "object": "chat.completion", "created": 0, "model": "tiny"}
        self.send({**head, "choices": [message], "usage": usage})

    def send(self, body: Any, status: int = 200, **headers: str) -> None:
        """Answer with any JSON, or with bytes."""
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.http.send_response(status)
        for name, value in {
            "Content-Type": "application/json",
            "Content-Length": str(len(data)),
            **headers,
        }.items():
            self.http.send_header(name, value)
        self.http.end_headers()
        self.http.wfile.write(data)


@contextmanager
def serving(handler: Handler) -> Iterator[tuple[str, list[Exchange]]]:
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

    with served(Http) as url:
        yield f"{url}/v1", seen
