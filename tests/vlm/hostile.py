"""Hostile and broken behaviours of a server, each with the cause by which its requests must be counted.

A behaviour whose cause is None comes with a valid answer, which must be used.
"""

from __future__ import annotations

import base64
import gzip
import json
import time
import zlib
from typing import Any
from urllib.parse import quote

import numpy as np

from tests.vlm.server import Exchange, Handler, completion

KEY = "sk-Very/Secret+Key=0123456789"
STATE = np.arange(18) / 10
FRAMES = 10


def answer(motion: list | None = None, durations: tuple[int, ...] = (4, 6), skill: str = "APPROACH", **extra) -> str:
    """Return a valid answer, or one that differs as told."""
    rows = [STATE.tolist()] * FRAMES if motion is None else motion
    frames = [{"frame_index": i + 1, "hand_params": row} for i, row in enumerate(rows)]
    program = [{"skill": skill, "params": {}, "duration": duration} for duration in durations]
    return json.dumps({"action_sequence": program, "predicted_motion": frames, **extra})


GOOD = json.dumps(completion(answer())).encode()
HEAD = b"HTTP/1.1 200 OK\r\n"
BOMB = gzip.compress(b" " * (50 << 20))
LONG_NUMBER = "1" + "0" * 400


def usage(literal: str) -> Handler:
    """Answer validly, with a literal of any size as the number of prompt tokens."""
    return lambda e: e.raw(GOOD.replace(b'"prompt_tokens": 100', b'"prompt_tokens": ' + literal.encode()))


def value(literal: str) -> Handler:
    """Answer with a literal of any size as a joint angle."""
    return lambda e: e.say(answer().replace("0.1", literal, 1))


def encoded(encoding: str, data: bytes) -> Handler:
    """Answer with a body in a content encoding."""
    return lambda e: e.raw(data, headers=[("Content-Encoding", encoding)])


def chunked(e: Exchange, chunk: bytes, flood: bool) -> None:
    """Begin an endless body in chunks."""
    e.write(HEAD + b"Transfer-Encoding: chunked\r\n\r\n")
    (e.flood if flood else e.drip)(b"%x\r\n%s\r\n" % (len(chunk), chunk))


def then(start: bytes, action: str, piece: bytes) -> Handler:
    """Send ``start``, then drip or flood with ``piece``."""

    def handle(e: Exchange) -> None:
        e.write(start)
        getattr(e, action)(piece)

    return handle


def redirect(e: Exchange) -> None:
    """Redirect to the same address, for ever."""
    e.raw(b"", 307, headers=[("Location", "/v1/chat/completions")])


def forms(key: str) -> dict[str, str]:
    """Return the API key in many encodings."""
    bearer, plain = f"Bearer {key}", base64.b64encode
    return {
        "plainly": bearer,
        "in capitals": key.upper(),
        "percent-encoded": quote(key, safe=""),
        "all percent-encoded": "".join(f"%{ord(c):02X}" for c in key),
        "twice percent-encoded": quote(quote(key, safe=""), safe=""),
        "in base64": plain(key.encode()).decode(),
        "in base64 of the header": plain(bearer.encode()).decode(),
        "in base64 at another offset": plain(("x" + bearer).encode()).decode(),
        "in URL-safe base64": base64.urlsafe_b64encode(key.encode()).decode(),
        "in hexadecimal": key.encode().hex(),
        "in JSON escapes": "".join(f"\\u{ord(c):04x}" for c in key),
        "in HTML escapes": "".join(f"&#{ord(c)};" for c in key),
    }


def echoes(key: str) -> dict[str, tuple[Handler, str | None]]:
    """Return behaviours that send the API key back."""
    bearer = f"Bearer {key}"
    table: dict[str, tuple[Handler, str | None]] = {
        f"echoes the key {name}": ((lambda e, text=text: e.say(text)), "unplayable")
        for name, text in forms(key).items()
    }
    header, line = [("Authorization", bearer), ("X-Echo", key)], f"HTTP/1.1 500 {bearer}\r\n".encode()
    return table | {
        "echoes the key in headers": (lambda e: e.raw(GOOD, headers=header), None),
        "echoes the key in an error": (lambda e: e.send({"error": {"message": bearer}}, 401), "http_4xx"),
        "echoes the key in the reason": (lambda e: e.write(line + b"Content-Length: 0\r\n\r\n"), "http_5xx"),
        "echoes the key in a broken head": (lambda e: e.write(f"{bearer}\r\n\r\n".encode()), "connection"),
        "echoes the key in a skill": (lambda e: e.say(answer(skill="x" * 25 + key)), "unplayable"),
        "echoes the key in redirects": (lambda e: e.raw(b"", 302, headers=[("Location", f"/?{key}")]), "http_3xx"),
        "echoes the key in escaped JSON": (
            lambda e: e.raw(GOOD.replace(b"APPROACH", "".join(f"\\\\u{ord(c):04x}" for c in key).encode())),
            "unplayable",
        ),
    }


SLOW: dict[str, tuple[Handler, str | None]] = {
    "silence": (lambda e: time.sleep(3.0), "timeout"),
    "drips spaces as a body": (lambda e: (e.raw(b"", promised=10_000), e.drip(b" ")), "timeout"),
    "drips chunks": (lambda e: chunked(e, b" ", flood=False), "timeout"),
    "drips the status line": (lambda e: e.drip(b"H"), "timeout"),
    "drips headers": (then(HEAD, "drip", b"X-A: 1\r\n"), "timeout"),
    "drips one long header": (then(HEAD + b"X-A: ", "drip", b"a"), "timeout"),
    "drips 100 Continue": (then(b"", "drip", b"HTTP/1.1 100 Continue\r\n\r\n"), "timeout"),
    "drips 103 Early Hints": (then(b"", "drip", b"HTTP/1.1 103 Early Hints\r\nLink: x\r\n\r\n"), "timeout"),
    "drips an error": (lambda e: (e.raw(b"", 500, promised=10_000), e.drip(b"x")), "timeout"),
    "drips gzip": (
        then(HEAD + b"Content-Encoding: gzip\r\nContent-Length: 9000\r\n\r\n" + BOMB[:10], "drip", b"\0\0\0\xff\xff"),
        "timeout",
    ),
    "drips chunk extensions": (then(HEAD + b"Transfer-Encoding: chunked\r\n\r\n1;", "drip", b"a"), "timeout"),
    "drips trailers": (then(HEAD + b"Transfer-Encoding: chunked\r\n\r\n0\r\n", "drip", b"X: 1\r\n"), "timeout"),
    "stalls within the body": (lambda e: (e.raw(GOOD[:50], promised=len(GOOD)), time.sleep(3.0)), "timeout"),
}

LARGE: dict[str, tuple[Handler, str | None]] = {
    "floods with headers": (then(HEAD, "flood", b"X-A: 1\r\n"), "connection"),
    "floods until it closes": (then(HEAD + b"\r\n", "flood", b" "), "malformed"),
    "sends 10 MB": (lambda e: e.say("x" * 10_000_000), "unplayable"),
    "sends 10 MB of error": (lambda e: e.raw(b"x" * 10_000_000, 500), "http_5xx"),
    "sends a gzip bomb": (encoded("gzip", BOMB), "malformed"),
}

BROKEN: dict[str, tuple[Handler, str | None]] = {
    "closes at once": (lambda e: None, "connection"),
    "resets the connection": (lambda e: e.http.connection.close(), "connection"),
    "cuts the body off": (lambda e: e.raw(b'{"id": ', promised=5000), "connection"),
    "sends bytes that are not HTTP": (lambda e: e.write(bytes(range(256)) * 4), "connection"),
    "sends two lengths": (lambda e: e.raw(GOOD, headers=[("Content-Length", "5")]), "connection"),
    "sends a negative length": (lambda e: e.raw(GOOD, promised=-1), "connection"),
    "sends a broken chunk": (lambda e: e.write(HEAD + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n"), "connection"),
    "compresses twice": (encoded("gzip, gzip", gzip.compress(gzip.compress(GOOD))), None),
    "sends an unknown encoding": (encoded("zstd", GOOD), None),
    "sends deflate, unasked": (encoded("deflate", zlib.compress(GOOD)), None),
    "sends gzip that is none": (encoded("gzip", GOOD), "connection"),
    "sends gzip cut off": (encoded("gzip", gzip.compress(GOOD)[:-9]), None),
    "switches protocols": (lambda e: e.write(b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: x\r\n\r\n"), "connection"),
    "redirects for ever": (redirect, "http_3xx"),
    "redirects elsewhere": (lambda e: e.raw(b"", 308, headers=[("Location", "http://127.0.0.1:9/")]), "http_3xx"),
    "asks for a password": (lambda e: e.send({"error": "who are you?"}, 401), "http_4xx"),
    "limits the rate": (lambda e: e.raw(b"{}", 429, headers=[("Retry-After", "86400")]), "http_4xx"),
    "fails": (lambda e: e.send({"error": "down"}, 500), "http_5xx"),
    "fails and asks for retries": (lambda e: e.raw(b"", 500, headers=[("x-should-retry", "true")]), "http_5xx"),
    "fails with deep JSON": (lambda e: e.raw(b"[" * 500_000, 500), "http_5xx"),
    "has a status of its own": (lambda e: e.write(b"HTTP/1.1 799 What\r\nContent-Length: 0\r\n\r\n"), "http_other"),
    "has no content": (lambda e: e.write(b"HTTP/1.1 204 None\r\n\r\n"), "malformed"),
}

WRONG: dict[str, tuple[Handler, str | None]] = {
    "sends HTML": (lambda e: e.raw(b"<html>"), "malformed"),
    "sends an empty body": (lambda e: e.raw(b""), "malformed"),
    "sends UTF-16": (lambda e: e.raw(GOOD.decode().encode("utf-16")), None),
    "sends bytes that are not UTF-8": (lambda e: e.raw(b"\xff\xfe\xfd" * 1000), "malformed"),
    "sends a list": (lambda e: e.send([1, 2, 3]), "malformed"),
    "sends no choices": (lambda e: e.send({"id": "1", "object": "x", "choices": []}), "malformed"),
    "sends a choice of null": (lambda e: e.send({"choices": [None]}), "malformed"),
    "sends choices as text": (lambda e: e.send({"choices": "yes"}), "malformed"),
    "sends null": (lambda e: e.say(None), "malformed"),
    "sends a number as text": (lambda e: e.say(7), "malformed"),
    "sends parts as text": (lambda e: e.say([{"type": "text", "text": answer()}]), "malformed"),
    "counts 100,000 digits as tokens": (usage("9" * 100_000), "malformed"),
    "nests 500,000 brackets": (lambda e: e.raw(b"[" * 500_000), "malformed"),
    "nests 100,000 objects": (lambda e: e.raw(b'{"a":' * 100_000), "malformed"),
    "nests brackets in usage": (usage("[" * 100_000 + "]" * 100_000), "malformed"),
    "nests brackets in the answer": (lambda e: e.say("[" * 60_000), "unplayable"),
    "refuses": (lambda e: e.say("I'm sorry, I can't."), "unplayable"),
    "answers with nothing": (lambda e: e.say(""), "unplayable"),
    "answers with lone surrogates": (lambda e: e.say("\ud800" * 100), "unplayable"),
    "answers with NaN": (value("NaN"), "unplayable"),
    "answers with infinity": (value("-Infinity"), "unplayable"),
    "answers with 1e999": (value("1e999"), "unplayable"),
    "answers with 401 digits": (value(LONG_NUMBER), "unplayable"),
    "answers with 50,000 digits": (value("9" * 50_000), "unplayable"),
}

USABLE: dict[str, tuple[Handler, str | None]] = {
    "compresses": (encoded("gzip", gzip.compress(GOOD)), None),
    "sends a byte order mark": (lambda e: e.raw(b"\xef\xbb\xbf" + GOOD), None),
    "sends 1,000 cookies": (
        lambda e: e.raw(GOOD, headers=[("Set-Cookie", f"a{i}=1; Path=/") for i in range(1000)]),
        None,
    ),
    "says 100 Continue once": (
        lambda e: (e.write(b"HTTP/1.1 100 Continue\r\n\r\n"), e.raw(GOOD)),
        None,
    ),
    "sends a second response unasked": (lambda e: (e.raw(GOOD), e.raw(b'{"choices": []}')), None),
}

UNKNOWN_USAGE: dict[str, Any] = {
    "text": '"many"',
    "null": "null",
    "a list": "[1]",
    "a fraction": "1.5",
    "NaN": "NaN",
    "Infinity": "Infinity",
    "-1": "-1",
    "10^10": str(10**10),
    "10^400": LONG_NUMBER,
    "1e400": "1e400",
}

HOSTILE: dict[str, tuple[Handler, str | None]] = {
    **SLOW,
    **LARGE,
    **BROKEN,
    **WRONG,
    **USABLE,
    **{f"counts {name} as tokens": (usage(literal), None) for name, literal in UNKNOWN_USAGE.items()},
    **echoes(KEY),
}


def in_turn(names: list[str] | None = None) -> Handler:
    """Return a handler that goes through behaviours by name, all by default, one for each request."""
    chosen = [HOSTILE[name][0] for name in names or HOSTILE]
    return lambda exchange: chosen[exchange.number % len(chosen)](exchange)
