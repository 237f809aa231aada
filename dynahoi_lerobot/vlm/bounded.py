"""An HTTP transport that a hostile or broken server cannot stall or flood."""

from __future__ import annotations

import time
from collections.abc import Iterator

import httpx2 as httpx


class BoundedTransport(httpx.BaseTransport):
    """Refuses bodies that are too large or too slow as they arrive, before they are held in memory.

    A client's own timeout counts from byte to byte, so a server that drips could hold it for ever.
    """

    def __init__(self, inner: httpx.BaseTransport, *, max_bytes: int, max_s: float) -> None:
        """Wrap ``inner``; a response may have ``max_bytes`` and take ``max_s`` seconds."""
        self._inner, self._max_bytes, self._max_s = inner, max_bytes, max_s

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """Send, and bound what comes back."""
        deadline = time.monotonic() + self._max_s
        response = self._inner.handle_request(request)
        assert isinstance(response.stream, httpx.SyncByteStream)
        response.stream = _Bounded(response.stream, self._max_bytes, deadline)
        return response

    def close(self) -> None:
        """Close the wrapped transport."""
        self._inner.close()


class _Bounded(httpx.SyncByteStream):
    def __init__(self, stream: httpx.SyncByteStream, max_bytes: int, deadline: float) -> None:
        self._stream, self._max_bytes, self._deadline = stream, max_bytes, deadline

    def __iter__(self) -> Iterator[bytes]:
        total = 0
        for chunk in self._stream:
            total += len(chunk)
            if total > self._max_bytes:
                raise httpx.ReadError(f"the response is larger than {self._max_bytes} bytes")
            if time.monotonic() > self._deadline:
                raise httpx.ReadTimeout("the response takes too long")
            yield chunk

    def close(self) -> None:
        self._stream.close()
