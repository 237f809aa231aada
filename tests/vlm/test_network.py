"""The deadline interrupts every phase of an exchange: name resolution, connecting, TLS, sending and receiving."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

import numpy as np
import pytest

from dynahoi_lerobot.vlm.client import VlmClient
from tests.vlm.hostile import GOOD, HEAD, STATE
from tests.vlm.server import CERTIFICATE, DRIP_S, listening, serving

IMAGE = np.zeros((8, 8, 3), np.uint8)
TIMEOUT_S, SLACK_S = 0.3, 1.0


def failure(url: str) -> str:
    """Return the cause for which a decision fails, within the deadline."""
    client, start = VlmClient("tiny", url, timeout_s=TIMEOUT_S, retries=3), time.monotonic()
    assert client.plan("", STATE, IMAGE) is None
    assert time.monotonic() - start < TIMEOUT_S + SLACK_S
    (cause,) = client.report()["failed_by"]
    return cause


def drip(connection: socket.socket, piece: bytes) -> None:
    for _ in range(int(4.0 / DRIP_S)):
        connection.sendall(piece)
        time.sleep(DRIP_S)


TLS: dict[str, tuple[Callable[[socket.socket], None], str]] = {
    "silence": (lambda c: time.sleep(4.0), "timeout"),
    "a handshake record that drips": (lambda c: (c.sendall(b"\x16\x03\x03\x40\x00"), drip(c, b"\x02")), "timeout"),
    "alerts that drip": (lambda c: drip(c, b"\x15\x03\x03\x00\x02\x01\x5a"), "connection"),
    "plain HTTP": (lambda c: c.sendall(HEAD + b"\r\n"), "connection"),
    "an end": (lambda c: None, "connection"),
}


@pytest.mark.parametrize("name", TLS)
def test_a_tls_handshake_ends_in_time(name: str):
    handler, cause = TLS[name]
    with listening(handler) as port:
        assert failure(f"https://127.0.0.1:{port}/v1") in (cause, "timeout")


def test_nobody_listens():
    with listening(lambda connection: None) as port:
        pass
    assert failure(f"http://127.0.0.1:{port}/v1") == "connection"


def test_a_certificate_that_nobody_trusts():
    with serving(lambda exchange: exchange.raw(GOOD), tls=True) as (url, seen):
        assert failure(url) == "connection"
    assert seen == []


def test_tls_with_a_trusted_certificate(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("SSL_CERT_FILE", str(CERTIFICATE))
    with serving(lambda exchange: exchange.raw(GOOD), tls=True) as (url, _):
        assert VlmClient("tiny", url).plan("", STATE, IMAGE) is not None
    with serving(lambda exchange: exchange.drip(b"HTTP/1.1 100 Continue\r\n\r\n"), tls=True) as (url, _):
        assert failure(url) == "timeout"


def test_name_resolution_that_hangs(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: time.sleep(3.0))
    assert failure("http://slow.invalid/v1") == "timeout"


def test_name_resolution_that_fails(monkeypatch: pytest.MonkeyPatch):
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    assert failure("http://unknown.invalid/v1") == "connection"
