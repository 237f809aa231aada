"""The page's server: one player at a time, on loopback unless a token guards it."""

from __future__ import annotations

import asyncio
import hmac
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
from aiohttp import WSCloseCode, WSMsgType, web

from dynahoi_lerobot.play.steering import Steering

if TYPE_CHECKING:
    import numpy as np

PAGE = Path(__file__).with_name("page.html")
MAX_MESSAGE_BYTES = 4096
LOOPBACK = ("127.0.0.1", "::1", "localhost")
JPEG_QUALITY = 90
BUSY, BAD_MESSAGE = 4001, 4002
"""Codes with which the socket is closed: somebody else is playing, and a message that cannot be
read."""


@dataclass
class Player:
    """Whoever sits at the page.

    Attributes:
        steering: the latest input.
        sent_ms: the time that the page gave with it, by its own clock [ms]; it is sent back with
            the next image.
        asked: the page's requests, oldest first; None once the page is closed.
    """

    socket: web.WebSocketResponse
    steering: Steering = field(default_factory=Steering)
    sent_ms: float | None = None
    asked: asyncio.Queue[str | None] = field(default_factory=lambda: asyncio.Queue(16))

    @property
    def gone(self) -> bool:
        """Whether the page was closed."""
        return self.socket.closed

    async def show(self, image: np.ndarray, **facts: Any) -> None:
        """Send an image (H, W, 3) uint8 RGB, and JSON values about it."""
        echo = self.sent_ms
        self.sent_ms = None
        encoded = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[
            1
        ]
        await self.tell(frame={**facts, "echo": echo})
        if not self.gone:
            await self.socket.send_bytes(encoded.tobytes())

    async def tell(self, **values: Any) -> None:
        """Send JSON values; nothing happens if the page was closed."""
        if not self.gone:
            await self.socket.send_str(json.dumps(values, allow_nan=False))

    def leave(self) -> None:
        """Ask for nothing any more."""
        while not self.asked.empty():
            self.asked.get_nowait()
        self.asked.put_nowait(None)

    def heed(self, message: Any) -> None:
        """Take a decoded message.

        Raises:
            ValueError: if it is neither an input nor a request.
        """
        if isinstance(message, dict) and isinstance(play := message.get("play"), str):
            if not self.asked.full():
                self.asked.put_nowait(play)
            return
        self.steering = Steering.read(message)
        sent = message.get("sent")
        self.sent_ms = float(sent) if isinstance(sent, int | float) and abs(sent) < 1e15 else None


class PlayServer:
    """Serves the page to one player at a time, whom ``game`` plays with.

    Attributes:
        address: of the page, with the token if there is one; empty until the server runs.
    """

    def __init__(
        self, game: Callable[[Player], Awaitable[None]], host: str, port: int, token: str
    ) -> None:
        """Take what plays with a player, and where to listen.

        Args:
            game: returns when the player has left.
            host, port: where to listen; port 0 takes a free one.
            token: required in the address; empty for none, on loopback alone.

        Raises:
            ValueError: if others could reach a server without a token.
        """
        if host not in LOOPBACK and not token:
            raise ValueError(f"host {host} can be reached by others, so it needs a token")
        self.address = ""
        self._game = game
        self._host = host
        self._port = port
        self._token = token
        self._playing: web.WebSocketResponse | None = None

    async def run(self, started: Callable[[str], None]) -> None:
        """Serve until canceled; ``started`` is called with the address of the page."""
        app = web.Application()
        app.add_routes([web.get("/", self._page), web.get("/play", self._socket)])
        app.on_shutdown.append(self._leave)
        runner = web.AppRunner(app, access_log=None, handle_signals=False)
        await runner.setup()
        try:
            site = web.TCPSite(runner, self._host, self._port)
            await site.start()
            port = runner.addresses[0][1]
            host = f"[{self._host}]" if ":" in self._host else self._host
            self.address = f"http://{host}:{port}/" + (
                f"?token={self._token}" if self._token else ""
            )
            started(self.address)
            await asyncio.Event().wait()
        finally:
            await runner.cleanup()

    async def _leave(self, app: web.Application) -> None:
        if self._playing is not None:
            await self._playing.close(code=WSCloseCode.GOING_AWAY, message=b"The game is over.")

    def _check(self, request: web.Request) -> None:
        """Refuse whoever lacks the token, and pages of other origins."""
        if not hmac.compare_digest(request.query.get("token", "").encode(), self._token.encode()):
            raise web.HTTPForbidden(
                text="This page needs the address with its token, as the command printed it."
            )
        if (
            self._host in LOOPBACK and (request.url.host or "") not in LOOPBACK
        ):  # a name rebound to this machine
            raise web.HTTPForbidden(text=f"This server is {self._host}, not {request.url.host}.")
        origin = request.headers.get("Origin")
        if origin is not None and origin != str(request.url.origin()):
            raise web.HTTPForbidden(text=f"Pages of {origin} may not play here.")

    async def _page(self, request: web.Request) -> web.Response:
        self._check(request)
        policy = (
            "default-src 'none'; img-src blob: data:; style-src 'unsafe-inline'; script-src "
            "'unsafe-inline'; "
        )
        headers = {
            "Content-Security-Policy": policy + "connect-src 'self'; frame-ancestors 'none'",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
        }
        return web.Response(
            text=PAGE.read_text(encoding="utf-8"), content_type="text/html", headers=headers
        )

    async def _socket(self, request: web.Request) -> web.WebSocketResponse:
        self._check(request)
        socket = web.WebSocketResponse(max_msg_size=MAX_MESSAGE_BYTES, heartbeat=20.0)
        await socket.prepare(request)
        if self._playing is not None:
            await socket.close(
                code=BUSY, message=b"somebody is playing already; close the other tab"
            )
            return socket
        self._playing = socket
        player = Player(socket)
        game = asyncio.ensure_future(self._game(player))
        try:
            async for message in socket:
                if game.done() or not await _heeded(player, message.type, message.data):
                    break
        finally:
            await socket.close()
            player.leave()
            try:
                await game  # it ends by itself once the page is gone, and saves the game
            finally:
                self._playing = None
        return socket


async def _heeded(player: Player, kind: WSMsgType, data: Any) -> bool:
    """Pass a message on; return whether it could be read, after closing the socket if not."""
    try:
        if kind != WSMsgType.TEXT:
            raise ValueError("a message must be text")
        player.heed(json.loads(data))
    except (ValueError, RecursionError) as error:
        await player.socket.close(code=BAD_MESSAGE, message=str(error).encode()[:120])
        return False
    return True
