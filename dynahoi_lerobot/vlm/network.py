"""A network backend that keeps one deadline and a byte limit over a whole exchange.

The timeouts of an HTTP client restart with every operation, so a server that sends a byte now and then holds it for
ever. Here every blocking operation, down to the single socket call, gets only the time that is left.
"""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from typing import Any

import httpcore2 as httpcore

from dynahoi_lerobot.vlm.deadline import Deadline
from dynahoi_lerobot.vlm.failures import Cause, RequestFailure

READ_SIZE = 8192
"""Bytes read at once, so that the deadline is also checked while a fast server floods."""


class BoundedBackend(httpcore.NetworkBackend):
    """Opens TCP connections whose every operation ends by a deadline, and which receive a limited number of bytes."""

    def __init__(self, deadline: Deadline, max_bytes: int) -> None:
        """Allow ``max_bytes`` to be received until `allow` sets a new limit."""
        self._deadline, self._left = deadline, max_bytes
        self._inner = httpcore.SyncBackend()

    def allow(self, max_bytes: int) -> None:
        """Allow ``max_bytes`` more to be received from now on."""
        self._left = max_bytes

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.NetworkStream:
        """Connect to the first address of ``host`` that answers; ``timeout`` is replaced by the time left."""
        error: Exception = httpcore.ConnectError(f"{host} has no address")
        for address in _resolve(host, port, self._deadline):
            try:
                left = self._deadline.remaining()
                stream = self._inner.connect_tcp(address, port, left, local_address, socket_options)
                return _BoundedStream(stream, self._deadline, self._spend)
            except (httpcore.ConnectError, httpcore.ConnectTimeout) as failed:
                error = failed
        raise error

    def _spend(self, count: int) -> None:
        self._left -= count
        if self._left < 0:
            raise RequestFailure(Cause.TOO_LARGE, "the response is larger than allowed")


class _BoundedStream(httpcore.NetworkStream):
    """A socket whose operations ignore the timeouts they are given and keep the deadline."""

    def __init__(self, inner: httpcore.NetworkStream, deadline: Deadline, spend: Callable[[int], None]) -> None:
        self._inner, self._deadline, self._spend = inner, deadline, spend

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        data = self._inner.read(min(max_bytes, READ_SIZE), self._deadline.remaining())
        self._spend(len(data))
        return data

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        # SyncStream.write grants its timeout to each of many `send` calls, which a slow reader can exploit.
        sock, view = self._inner.get_extra_info("socket"), memoryview(buffer)
        while view:
            sock.settimeout(self._deadline.remaining())
            try:
                view = view[sock.send(view) :]
            except TimeoutError as error:
                raise httpcore.WriteTimeout(str(error)) from error
            except OSError as error:
                raise httpcore.WriteError(str(error)) from error

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore.NetworkStream:
        # The ssl module keeps one timeout over all steps of a handshake.
        stream = self._inner.start_tls(ssl_context, server_hostname, self._deadline.remaining())
        return _BoundedStream(stream, self._deadline, self._spend)

    def get_extra_info(self, info: str) -> Any:
        return self._inner.get_extra_info(info)

    def close(self) -> None:
        self._inner.close()


def _resolve(host: str, port: int, deadline: Deadline) -> list[str]:
    """Return the addresses of ``host``; a resolver that hangs is left behind in a daemon thread."""
    answer: Future[list[str]] = Future()

    def ask() -> None:
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
            answer.set_result(list(dict.fromkeys(str(entry[4][0]) for entry in found)))
        except Exception as error:
            answer.set_exception(error)

    threading.Thread(target=ask, daemon=True, name="resolve").start()
    try:
        return answer.result(deadline.remaining())
    except TimeoutError as error:
        raise httpcore.ConnectTimeout(f"{host} was not resolved in time") from error
    except OSError as error:
        raise httpcore.ConnectError(str(error)) from error
