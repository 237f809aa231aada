"""The page for people: its server, its rules and what it keeps, through a real socket."""

import asyncio
from dataclasses import replace

import aiohttp
import pytest

from dynahoi_lerobot.core.agent import Actor
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.evaluate.actors import make_actor
from dynahoi_lerobot.play.game import PRACTICE, SCORED, SHOWN, Game
from dynahoi_lerobot.play.live_world import LiveWorld
from dynahoi_lerobot.play.server import BAD_MESSAGE, BUSY, MAX_MESSAGE_BYTES, PlayServer
from dynahoi_lerobot.play.steering import Steering
from dynahoi_lerobot.sampling.recipe import Recipe

RECIPE = Recipe.of(split="val", image_size=32)


class Fast:
    """A clock on which every reading is a frame later, so that nobody ever waits for the next
    one.
    """

    now_s = 0.0

    def __call__(self) -> float:
        self.now_s += 0.05
        return self.now_s


def game(kept: list[Episode], episodes: int = 2, others: tuple[Actor, ...] = ()) -> Game:
    worlds = (
        LiveWorld(replace(RECIPE, split=split), "constant", record_images=True, clock=Fast())
        for split in ("val", "train")
    )
    return Game(*worlds, list(range(episodes)), episodes, "human:test", others, kept.append)


def playing(kept: list[Episode], player, *, host: str = "127.0.0.1", token: str = "", **options):
    """Return what the coroutine ``player(session, address)`` returns while the server runs."""

    async def both():
        address = asyncio.get_running_loop().create_future()
        server = asyncio.ensure_future(
            PlayServer(game(kept, **options), host, 0, token).run(address.set_result)
        )
        async with aiohttp.ClientSession() as session, asyncio.timeout(300):
            try:
                return await player(session, (await address).replace("0.0.0.0", "127.0.0.1"))
            finally:
                server.cancel()

    return asyncio.run(both())


def socket_of(address: str) -> str:
    return address.replace("?", "play?") if "?" in address else f"{address}play"


async def told(socket: aiohttp.ClientWebSocketResponse, name: str):
    """Return the next value of that name that the server tells; None if it closes the socket."""
    async for message in socket:
        if message.type == aiohttp.WSMsgType.TEXT and name in (values := message.json()):
            return values[name]
    return None


async def seated(session: aiohttp.ClientSession, address: str) -> aiohttp.ClientWebSocketResponse:
    """Come to the page until its one place is free."""
    while True:
        socket = await session.ws_connect(socket_of(address))
        if await told(socket, "ready"):
            return socket
        await asyncio.sleep(0.02)


def test_an_episode_is_shown_scored_and_compared():
    async def player(session, address):
        async with session.ws_connect(socket_of(address), max_msg_size=0) as socket:
            assert (await told(socket, "ready"))["left"] == 2
            await socket.send_json({"play": PRACTICE})
            practice = await told(socket, "result")
            assert (await told(socket, "ready"))["left"] == 2, "practice does not count"
            await socket.send_json({"play": SCORED})
            frame = await told(socket, "frame")
            image = (await socket.receive()).data
            scored = await told(socket, "result")
            assert (await told(socket, "ready"))["left"] == 1
            return practice, frame, image, scored

    kept: list[Episode] = []
    practice, frame, image, scored = playing(kept, player, others=(make_actor("expert"),))
    assert practice["practice"]
    assert not scored["practice"]
    assert frame["window_s"] > 0
    assert image[:2] == b"\xff\xd8", "a JPEG"
    you, expert = scored["players"]
    assert expert["success"]
    assert not you["success"]
    assert set(you["metrics"]) == set(SHOWN)
    assert len(kept) == 1
    assert kept[0].meta.agent == "human:test"
    assert kept[0].images


MALFORMED = [
    "{",
    '{"x": NaN, "y": 0, "depth": 0, "closed": 0}',
    '{"play": 3}',
    "9" * (MAX_MESSAGE_BYTES + 1),
]


def test_one_plays_at_a_time_and_a_malformed_message_ends_a_connection_and_nothing_else():
    async def player(session, address):
        for message in MALFORMED:
            async with await seated(session, address) as socket:
                second = await session.ws_connect(socket_of(address))
                await told(second, "ready")
                assert second.close_code == BUSY
                await socket.send_str(message)
                await told(socket, "anything")
                assert socket.close_code in (BAD_MESSAGE, aiohttp.WSCloseCode.MESSAGE_TOO_BIG), (
                    message[:50]
                )
        await (await seated(session, address)).close()

    playing([], player)


def test_a_page_closed_in_the_middle_of_an_episode_loses_nothing():
    async def player(session, address):
        async with session.ws_connect(socket_of(address)) as socket:
            await socket.send_json({"play": SCORED})
            await told(socket, "frame")
        while not kept:
            await asyncio.sleep(0.01)
        async with session.ws_connect(socket_of(address)) as socket:
            return await told(socket, "ready")

    kept: list[Episode] = []
    assert playing(kept, player)["left"] == 1, "the world went on, and the episode counts"
    assert len(kept) == 1


def test_foreign_pages_rebound_names_and_missing_tokens_are_refused():
    async def status(session, address, **headers):
        return [
            (await session.get(place, headers=headers)).status
            for place in (address, socket_of(address))
        ]

    async def local(session, address):
        evil = {"Origin": "http://evil.example"}, {"Host": "evil.example"}
        return [await status(session, address, **headers) for headers in evil]

    async def reached_by_others(session, address):
        page = await session.get(address)
        return page.status, await status(session, address.partition("?")[0])

    assert playing([], local) == [[403, 403], [403, 403]]
    assert playing([], reached_by_others, host="0.0.0.0", token="secret") == (200, [403, 403])
    with pytest.raises(ValueError, match="token"):
        PlayServer(game([]), "0.0.0.0", 0, "")


def test_steering_moves_the_palm_where_it_points():
    world = LiveWorld(RECIPE, "constant", realtime=False)
    world.begin(0, "test")
    home = Steering().command(world)
    right = Steering(x=1.0).command(world) - home
    up = Steering(y=1.0).command(world) - home
    forward = Steering(depth=1.0).command(world) - home
    closed = Steering(closed=1.0).command(world) - home
    assert right[1] < -0.1, "the palm faces +x, so right is -y"
    assert up[2] > 0.1
    assert forward[0] > 0.1
    assert abs(closed[:3]).max() == 0
    assert abs(closed[3:]).min() > 0
