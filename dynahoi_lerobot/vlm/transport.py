"""An HTTP transport that returns a response complete and within bounds, or raises a `RequestFailure`."""

from __future__ import annotations

import re
import ssl
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property

import httpcore2 as httpcore
import httpx2 as httpx

from dynahoi_lerobot.vlm.deadline import Deadline
from dynahoi_lerobot.vlm.failures import Cause, RequestFailure
from dynahoi_lerobot.vlm.network import BoundedBackend
from dynahoi_lerobot.vlm.redaction import Redactor

MAX_HEAD = 64 << 10
"""Bytes received until the response head is complete, any ``100 Continue`` included."""
MAX_BODY = 1 << 20
"""Bytes of a response body, decompressed."""
MAX_SENT_BODY = 2 * MAX_BODY
"""Bytes received for a response body, its chunk headers included."""
GZIP = 16 + zlib.MAX_WBITS
RETRY_AFTER = re.compile(rb"[0-9]{1,6}")
EXCERPT = 200
"""Characters of an error response that are kept."""


class BoundedTransport(httpx.BaseTransport):
    """Sends each request on a connection of its own, under one deadline.

    The timeout of a request, ``timeout["read"]`` [s] in its extensions, is the time for the whole exchange: name
    resolution, connecting, TLS, sending, and receiving head and body. Of the response only the status, the
    seconds of ``Retry-After`` and the body are passed on, the body decompressed and without the API key; so other
    headers, cookies and redirects have no effect.
    """

    def __init__(self, redact: Redactor) -> None:
        """Remove from every response what ``redact`` finds."""
        self._redact = redact

    @cached_property
    def _ssl_context(self) -> ssl.SSLContext:
        return httpcore.default_ssl_context()  # takes about 30 ms

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """Return the response, already read.

        Raises:
            RequestFailure: if it is late, too large, not valid HTTP, compressed in a way that was not asked for, or has
                a status other than 2xx.
        """
        request.headers["Accept-Encoding"] = "gzip"
        with self._translated_errors():
            status, wait_s, body = self._exchange(request)
        text = self._redact(body.decode("utf-8-sig", "replace"))
        if not 200 <= status < 300:
            raise RequestFailure(Cause.of_status(status), f"HTTP {status}: {text.strip()[:EXCERPT]}", status, wait_s)
        return httpx.Response(status, headers={"Content-Type": "application/json"}, content=text.encode())

    def _exchange(self, request: httpx.Request) -> tuple[int, float | None, bytes]:
        deadline = Deadline(request.extensions["timeout"]["read"])
        backend = BoundedBackend(deadline, MAX_HEAD)
        context = self._ssl_context if request.url.scheme == "https" else None
        with (
            httpcore.ConnectionPool(context, network_backend=backend) as pool,
            pool.stream(
                request.method, str(request.url), headers=request.headers.raw, content=request.read()
            ) as response,
        ):
            backend.allow(MAX_SENT_BODY)
            return response.status, _retry_after_s(response), _read_body(response, deadline)

    @contextmanager
    def _translated_errors(self) -> Iterator[None]:
        try:
            yield
        except httpcore.TimeoutException as error:
            raise RequestFailure(Cause.TIMEOUT, self._describe(error)) from None
        except httpcore.NetworkError as error:
            raise RequestFailure(Cause.CONNECTION, self._describe(error)) from None
        except (httpcore.ProtocolError, zlib.error) as error:
            raise RequestFailure(Cause.MALFORMED, self._describe(error)) from None

    def _describe(self, error: Exception) -> str:
        return self._redact(f"{type(error).__name__}: {error}")[:EXCERPT]


def _retry_after_s(response: httpcore.Response) -> float | None:
    """Return the seconds of a ``Retry-After`` header; None for a date or anything else."""
    values = [value for name, value in response.headers if name.lower() == b"retry-after"]
    return float(values[0]) if len(values) == 1 and RETRY_AFTER.fullmatch(values[0]) else None


def _read_body(response: httpcore.Response, deadline: Deadline) -> bytes:
    body = bytearray()
    for piece in _decoded(response, deadline):
        body += piece
        if len(body) > MAX_BODY:
            raise RequestFailure(Cause.TOO_LARGE, f"the response body is larger than {MAX_BODY} bytes")
    return bytes(body)


def _decoded(response: httpcore.Response, deadline: Deadline) -> Iterable[bytes]:
    """Return the pieces of the body; none is larger than one byte more than the limit."""
    named = b",".join(value for name, value in response.headers if name.lower() == b"content-encoding")
    encoding = named.strip().lower().decode("latin-1")
    pieces = _timed(response, deadline)
    if encoding in ("", "identity"):
        return pieces
    if encoding in ("gzip", "x-gzip"):
        return _gunzip(pieces)
    raise RequestFailure(Cause.MALFORMED, "the response body has a content encoding other than gzip")


def _timed(response: httpcore.Response, deadline: Deadline) -> Iterator[bytes]:
    for piece in response.iter_stream():
        deadline.remaining()
        yield piece


def _gunzip(pieces: Iterable[bytes]) -> Iterator[bytes]:
    decoder = zlib.decompressobj(GZIP)
    for piece in pieces:
        yield decoder.decompress(piece, MAX_BODY + 1)
        if decoder.eof:
            return
        if decoder.unconsumed_tail:
            raise RequestFailure(Cause.TOO_LARGE, f"the decompressed response body is larger than {MAX_BODY} bytes")
    raise RequestFailure(Cause.MALFORMED, "the compressed response body ends early")
