"""Play the real page in the system's Chromium, along the expert's path: S_loc, jitter and latency.

    python benchmarks/play.py --episodes 20 --json FILE
    python benchmarks/play.py --episodes 1 --film docs/images/play.gif

The pointer is moved and keys are pressed through the DevTools protocol, so that everything between
a person's hand and the world is in it. Chromium is Debian's package `chromium`.
"""

import argparse
import asyncio
import base64
import io
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Coroutine
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
from PIL import Image
from support.options import benchmark_parser, parse_options, write_numbers

from dynahoi_lerobot.core.conventions import CONTROL_DT, EGO_VIEW, PALM_DOF
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.evaluate.actors import make_actor
from dynahoi_lerobot.evaluate.gif import write_gif
from dynahoi_lerobot.metrics import measure
from dynahoi_lerobot.play.game import Game
from dynahoi_lerobot.play.live_world import LiveWorld
from dynahoi_lerobot.play.server import PlayServer
from dynahoi_lerobot.play.steering import POINTED_M
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.scene.pinhole import Pinhole

DEADBAND_M = 0.01
CLOSED_RAD = 0.1
FILM_PX = (820, 760)
FILM_FPS = 10
RESULT_S = 3.0
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-port=0",
    "--window-size=1280,960",
]


class Tab:
    """A page of Chromium through the DevTools protocol."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self._number = 0
        self._answers = dict[int, asyncio.Future[Any]]()
        self._filmed: list[tuple[float, bytes]] = []
        self._reader = asyncio.ensure_future(self._read())

    async def _read(self) -> None:
        async for message in self._socket:
            answer = json.loads(message.data)
            waiting = self._answers.pop(answer.get("id"), None)
            if waiting is not None:
                waiting.set_result(answer)
            elif answer.get("method") == "Page.screencastFrame":
                shot = answer["params"]
                self._filmed.append((shot["metadata"]["timestamp"], base64.b64decode(shot["data"])))
                parameters = {"sessionId": shot["sessionId"]}
                await self._socket.send_json(
                    {"id": 0, "method": "Page.screencastFrameAck", "params": parameters}
                )

    async def call(self, method: str, **parameters: Any) -> Any:
        """Return the result of a command of the protocol."""
        self._number += 1
        waiting = asyncio.get_running_loop().create_future()
        self._answers[self._number] = waiting
        message = {"id": self._number, "method": method, "params": parameters}
        await self._socket.send_json(message)
        return (await waiting)["result"]

    async def value(self, expression: str) -> Any:
        """Return the value of an expression of JavaScript."""
        found = await self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        return found["result"].get("value")

    async def until(self, expression: str, seconds: float = 60.0) -> None:
        async with asyncio.timeout(seconds):
            while not await self.value(expression):
                await asyncio.sleep(0.1)

    async def press(self, keys: set[str], held: set[str]) -> None:
        """Let ``keys`` be down, by their codes, of which some are ``held`` so far."""
        for code in keys ^ held:
            name = " " if code == "Space" else code[-1].lower()
            kind = "keyDown" if code in keys else "keyUp"
            await self.call("Input.dispatchKeyEvent", type=kind, code=code, key=name)

    async def film(self, path: Path, episode: Coroutine[Any, Any, None]) -> None:
        """Film the page in a small window during an episode, and its result, as a GIF."""
        size = {"width": FILM_PX[0], "height": FILM_PX[1], "deviceScaleFactor": 1, "mobile": False}
        await self.call("Emulation.setDeviceMetricsOverride", **size)
        await self.call("Page.startScreencast", format="png", maxWidth=FILM_PX[0] // 2)
        await episode
        await asyncio.sleep(RESULT_S)
        await self.call("Page.stopScreencast")
        times_s = [time_s for time_s, _ in self._filmed]
        ticks_s = np.arange(times_s[0], times_s[-1], 1 / FILM_FPS)
        frames = []
        for i in np.searchsorted(times_s, ticks_s, side="right") - 1:
            image = Image.open(io.BytesIO(self._filmed[i][1]))
            frames.append(np.asarray(image.convert("RGB")))
        # the first may be from before the window got its size
        same = [frame for frame in frames if frame.shape == frames[-1].shape]
        write_gif(path, np.stack(same), fps=FILM_FPS)


@asynccontextmanager
async def chromium(address: str):
    """Open a page in a new Chromium and yield its tab."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        raise SystemExit(
            "there is no chromium on this machine; install Debian's package `chromium`"
        )
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [program, *FLAGS, f"--user-data-dir={profile}", address]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            port_file = Path(profile) / "DevToolsActivePort"
            async with asyncio.timeout(60):
                while not port_file.exists():
                    await asyncio.sleep(0.1)
            port = port_file.read_text().split()[0]
            async with aiohttp.ClientSession() as session:
                async with session.get(f"http://127.0.0.1:{port}/json") as answer:
                    targets = await answer.json(content_type=None)
                [page] = [target for target in targets if target["type"] == "page"]
                url = page["webSocketDebuggerUrl"]
                async with session.ws_connect(url, max_msg_size=0) as socket:
                    yield Tab(socket)
        finally:
            process.kill()
            process.wait()


async def follow_expert(tab: Tab, world: LiveWorld) -> None:
    """Move pointer and keys along the expert's path until the episode is over."""
    box = await tab.value("document.getElementById('view').getBoundingClientRect().toJSON()")
    hand = world.batch.scene.hand
    camera = Pinhole.of(world.batch.scene.model, EGO_VIEW)
    held: set[str] = set()
    while world.finished is None:
        goal = world.expert_goal()
        right, up, back = camera.axes.T @ (goal[:PALM_DOF] - world.batch.state[0, :PALM_DOF])
        x, y = np.clip(np.array([right, up]) / camera.half_view / POINTED_M, -1, 1)
        place = {
            "x": box["left"] + (x + 1) / 2 * box["width"],
            "y": box["top"] + (1 - y) / 2 * box["height"],
        }
        await tab.call("Input.dispatchMouseEvent", type="mouseMoved", **place)
        keys = set()
        if back < -DEADBAND_M:
            keys.add("KeyW")
        if back > DEADBAND_M:
            keys.add("KeyS")
        if np.abs(goal[PALM_DOF:] - hand.open_joints()).max() > CLOSED_RAD:
            keys.add("Space")
        await tab.press(keys, held)
        held = keys
        await asyncio.sleep(CONTROL_DT / 2)
    await tab.press(set(), held)


async def played(args: argparse.Namespace) -> dict[str, Any]:
    """Play the episodes; return the figures."""
    recipe = Recipe.of(split="val", image_size=192)
    world = LiveWorld(recipe, record_images=True)
    practice = LiveWorld(replace(recipe, split="train"), record_images=True)
    episodes: list[Episode] = []
    game = Game(
        world,
        practice,
        list(range(args.episodes)),
        args.episodes,
        "human:script",
        [make_actor("expert")],
        episodes.append,
    )
    address: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    server = asyncio.ensure_future(PlayServer(game, "127.0.0.1", 0, "").run(address.set_result))
    async with chromium(await address) as tab:
        for number in range(args.episodes):
            await tab.until("document.querySelectorAll('#panel button').length > 1")
            await tab.value("[...document.querySelectorAll('#panel button')].at(-1).click()")
            await tab.until("playing && frame")
            await follow_expert(tab, world)
            await tab.until(f"(window.results || []).length >= {2 * (number + 1)}")
        figures = await tab.value("measured()")
        if args.film:
            await tab.value("[...document.querySelectorAll('#panel button')].at(0).click()")
            await tab.until("playing && frame")
            await tab.film(args.film, follow_expert(tab, practice))
    server.cancel()
    measured = [measure(episode) for episode in episodes]
    return {
        "episodes": len(episodes),
        "S_loc": float(np.mean([metrics["S_loc"] or 0 for metrics in measured])),
        "S_joint": float(np.mean([metrics["S_joint"] or 0 for metrics in measured])),
        **figures,
        "load": os.getloadavg()[0],
    }


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--film", type=Path, help="GIF of a further, practised episode")
    args = parse_options(parser, {"episodes": 1})
    figures = asyncio.run(played(args))
    print(json.dumps(figures, indent=2))
    write_numbers(args, **figures)


if __name__ == "__main__":
    main()
