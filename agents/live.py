"""Web server of laboratories that people watch and play in a browser: a page for spectators, and one for each seat."""

from __future__ import annotations

import asyncio
import hmac
import html
import json
import secrets
import threading
import traceback
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.config.extras import needs

with needs("a live page needs starlette and uvicorn", "live"):
    import anyio.to_thread
    import uvicorn
    from starlette.applications import Starlette
    from starlette.exceptions import HTTPException
    from starlette.middleware import Middleware
    from starlette.middleware.trustedhost import TrustedHostMiddleware
    from starlette.requests import Request
    from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response, StreamingResponse
    from starlette.routing import Route

from chemlab import __version__
from chemlab.config.scenario import Scenario
from chemlab.envs.players import Players
from chemlab.record import verify_record
from chemlab.render.replay_page import MOST_TURNS, Film, filled_page, side_by_side
from chemlab.roles.bench import channel_slices

from .briefs import brief
from .policies import agent_policy
from .seats import Reply, Room
from .verbs import Verb

SPEEDS = (1, 2, 6, 15, 40, 60)
"""Possible speeds in turns per second."""
LOCAL = ("127.0.0.1", "localhost")
"""Host names of the local machine."""
_NEWS_S = 0.05
"""Minimum time in s between two messages to a page; a message has all turns since the last one."""
_LONGEST_ERROR = 300
"""Maximum number of characters of an error on a page."""
_LARGEST_MESSAGE = 10_000
"""Maximum number of bytes of a message to the server."""
_HEADERS = {
    "Content-Security-Policy": "frame-ancestors 'self'",
    "Cache-Control": "no-store",
    "Referrer-Policy": "same-origin",
}
_FRAMED = "default-src 'none'; frame-src 'self'; style-src 'unsafe-inline'; img-src data:"


class Live:
    """A laboratory that policies play turn by turn, and in which people can take and leave seats.

    Args:
        scenario: the scenario.
        policy: name of the policy of the agents whose seat is free.
        seed: seed of the first episode.
        split: split of hidden parameters.
        folder: folder of the records.
    """

    def __init__(self, scenario: Scenario, policy: str, seed: int, split: str, folder: Path) -> None:
        self._scenario, self._policy, self._split, self._folder = scenario, policy, split, folder
        self._lock = threading.RLock()
        self.taken: set[str] = set()
        self._unseen: set[str] = set()
        """Agents whose policy has not acted in the current experiment or episode, since a person played first."""
        self.episode = ""
        """Random id of the episode."""
        self.room: Room
        self.begin(seed)

    def begin(self, seed: int) -> None:
        """Start an episode; close the record of the running one."""
        with self._lock:
            if self.episode:
                self.room.close()
            self.seed, self.verdict = seed, ("", "")
            self.room = Room(
                self._scenario,
                self._scenario.agents(),
                self._policy,
                folder=self._folder,
                seed=seed,
                split=self._split,
                watch=lambda tick, played: self.film.add(tick, [played]),
            )
            labs = self.room.laboratories
            self._players = Players(labs, [agent_policy(self._policy, labs, i) for i in range(len(labs.agents))])
            self._players.seed(0, seed)
            self._unseen.clear()
            self.film, self.episode = Film(labs), secrets.token_hex(8)

    @property
    def turn(self) -> str:
        """Agent with the turn; empty after the end of the episode."""
        labs = self.room.laboratories
        return "" if self.room.over else labs.agents[labs.turn()]

    @property
    def waits(self) -> bool:
        """True if no policy can play: a person has the turn, or the episode is over or too long for a page."""
        return self.room.over or self.turn in self.taken or self.film.turns >= MOST_TURNS

    def step(self, turns: int = 1) -> None:
        """Let policies play up to this number of turns, until :attr:`waits` is True."""
        for _ in range(turns):
            with self._lock:
                if self.waits:
                    return
                labs = self.room.laboratories
                number, agent = labs.turn(), self.turn
                # A policy that takes over within an experiment begins without memory of earlier ones.
                step = np.zeros(1, np.int64) if agent in self._unseen else labs.roles[number].turns_had
                self._unseen.discard(agent)
                self.room.play(agent, self._players.decide(number, labs.members, step)[0])

    def call(self, agent: str, verb: str, arguments: Mapping[str, Any]) -> Reply:
        """Play a call of the person at a seat, and return the reply."""
        with self._lock:
            labs = self.room.laboratories
            if self.turn == agent and not labs.roles[labs.agents.index(agent)].turns_had[0]:
                self._unseen.add(agent)
            return self.room.call(agent, verb, arguments)

    def page(self, number: int) -> str:
        """Return the HTML of the spectators' page."""
        with self._lock:
            data = {
                **self.film.still(),
                "seed": str(self.seed),  # JavaScript's numbers have 53 bits
                "version": __version__,
                "policies": {},
                "verified": {"status": "live", "message": ""},
                "stopped": "",
                "calls": [],
                "live": f"/lab/{number}",
                "episode": self.episode,
                **self.film.since(),
            }
        return filled_page("replay.html", data, "'self'")

    def words(self) -> tuple[str, str]:
        """Return a line about the episode, and its kind: ``good``, ``soft`` or ``warn``."""
        if not self.room.over:
            at = self.turn
            if self.film.turns >= MOST_TURNS:
                return f"stopped: a page shows at most {MOST_TURNS} turns; begin a new episode", "warn"
            if at in self.taken:
                return f"waiting for the person at {at}", "warn"
            return "true contents: for spectators", "soft"
        status, message = self.verdict
        over = f"over: score {self.room.score:.3f}".replace("-", "\u2212")  # a minus sign, as elsewhere on the page
        if not status:
            return f"{over}; the record is being checked", "soft"
        checked = "record verified" if status == "ok" else f"record {status}: {message}"
        return f"{over}; {checked}", "good" if status == "ok" else "warn"

    def check(self) -> None:
        """Verify the record of the episode, if it is over."""
        with self._lock:
            if not self.room.over:
                return  # the next one has begun
            episode, record = self.episode, self.room.record
        found = verify_record(record, self._scenario, True, self._split)  # its parts have been imported
        with self._lock:
            if self.episode == episode:
                self.verdict = (found.status, found.message)

    def seat(self, agent: str) -> dict[str, Any]:
        """Return the data of a seat's page: the observation as text and curves, and the legal arguments."""
        with self._lock:
            labs = self.room.laboratories
            number, turn = labs.agents.index(agent), self.turn
            seen, channels = labs.observe(number, labs.members)[0], labs.roles[number].channels
            slices = channel_slices(channels)
            curves = [
                {"name": one.name, "unit": one.unit, "values": seen[slices[one.name]].round(3).tolist()}
                for one in channels
                if one.unit in ("absorption", "grey") and seen[slices[one.name]].any()
            ]
            return {
                "turn": turn,
                "number": self.room.number(agent),
                "over": self.room.over,
                "taken": agent in self.taken,
                "text": self.room.display(agent),
                "curves": curves,
                "choices": self._choices(agent) if turn == agent else {},
            }

    def acts(self, agent: str) -> list[Verb]:
        """Return the verbs of a seat that are actions of the laboratory."""
        return [verb for verb in self.room.verbs(agent) if verb.action is not None]

    def _choices(self, agent: str) -> dict[str, dict[str, list[Any]]]:
        """Return, by verb with a legal action, the values of each argument that occur in legal actions."""
        labs = self.room.laboratories
        mask = labs.mask(labs.agents.index(agent), labs.members)
        found: dict[str, dict[str, list[Any]]] = {}
        for verb in self.acts(agent):
            ways = [{}] if mask is None else [given for given, action in verb.ways() if mask[0, action]]
            if ways:
                found[verb.name] = {name: list(dict.fromkeys(given[name] for given in ways)) for name in ways[0]}
        return found


class _Show:
    """Laboratories under common control, and notification of all open pages."""

    def __init__(self, lives: Sequence[Live], policies: Sequence[str], paused: bool, speed: int) -> None:
        self.lives, self.policies = lives, policies
        self.playing, self.speed, self.due = not paused, speed, dict.fromkeys(lives, 0)
        self.failed: dict[Live, str] = {}
        self.changed, self.news = asyncio.Condition(), 0
        self.server: uvicorn.Server | None = None

    async def tell(self) -> None:
        """Notify all pages of a change."""
        async with self.changed:
            self.news += 1
            self.changed.notify_all()

    async def rounds(self) -> AsyncIterator[None]:
        """Yield at once and after changes, with pauses of at least ``_NEWS_S``, until the server stops."""
        heard = self.news

        async def more() -> None:  # as a task with a lock of its own: a cancelled waiter must not release another's
            async with self.changed:
                await self.changed.wait_for(lambda: self.news > heard)

        yield
        while self.server is None or not self.server.should_exit:
            await asyncio.sleep(_NEWS_S)
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(more(), 0.5)
                heard = self.news
                yield

    async def run(self, live: Live) -> None:
        """Play a laboratory whenever it is not paused; an error of a policy or a part pauses it."""
        while True:
            async with self.changed:
                await self.changed.wait_for(lambda: not live.waits and (self.playing or self.due[live] > 0))
            self.due[live] = max(self.due[live] - 1, 0)
            began = asyncio.get_running_loop().time()
            turns = max(int(self.speed * _NEWS_S), 1) if self.playing else 1
            try:
                await anyio.to_thread.run_sync(live.step, turns)
                await self.after(live)
            except Exception as error:  # also of policies and parts
                traceback.print_exc()
                self.playing, self.due = False, dict.fromkeys(self.lives, 0)
                self.failed[live] = f"{type(error).__name__}: {error}"[:_LONGEST_ERROR]
                await self.tell()
            if self.playing:
                taken = asyncio.get_running_loop().time() - began
                await asyncio.sleep(max(turns / self.speed - taken, 0.0))

    async def after(self, live: Live) -> None:
        """Notify pages after a turn; at the end of the episode, verify the record."""
        await self.tell()
        if live.room.over and not live.verdict[0]:
            await anyio.to_thread.run_sync(live.check)
            await self.tell()

    async def order(self, given: Mapping[str, Any]) -> None:
        """Carry out a command of the spectators' page.

        Raises:
            ValueError: the command is unknown.
        """
        what, value = given.get("do"), given.get("value")
        if what in ("play", "step", "new"):
            self.failed.clear()
        if what in ("play", "pause"):
            self.playing = what == "play"
        elif what == "step":
            self.playing, self.due = False, {live: count + 1 for live, count in self.due.items()}
        elif what == "speed" and value in SPEEDS:
            self.speed = int(value)
        elif what == "new":
            seed = max(live.seed for live in self.lives) + 1
            for live in self.lives:
                await anyio.to_thread.run_sync(live.begin, seed)
        else:
            speeds = ", ".join(map(str, SPEEDS))
            raise ValueError(f"do: must be play, pause, step, new, or speed with a value of {speeds}")
        await self.tell()

    def status(self, live: Live) -> dict[str, Any]:
        """Return the data that the page shows in addition to the turns."""
        words, kind = (self.failed[live], "warn") if live in self.failed else live.words()
        return {
            "playing": self.playing,
            "speed": self.speed,
            "over": live.room.over,
            "turn": live.turn,
            "policy": self.policies[self.lives.index(live)],
            "seats": {agent: agent in live.taken for agent in live.room.seats},
            "words": words,
            "kind": kind,
        }


def _event(name: str, data: Any) -> str:
    return f"event: {name}\ndata: {json.dumps(data, separators=(',', ':'))}\n\n"


async def _film(show: _Show, live: Live, mark: list[int], episode: str) -> AsyncIterator[str]:
    """Yield the events of a laboratory for one spectator."""
    told: Any = None
    async for _ in show.rounds():
        if live.episode != episode:
            yield _event("episode", live.episode)
            return
        part = live.film.since(*mark)
        if part["turns"]:
            mark = [mark[0] + len(part["turns"]), mark[1] + len(part["shapes"]), mark[2] + len(part["pool"])]
            yield _event("film", part)
        if told != (now := show.status(live)):
            told = now
            yield _event("status", now)


async def _seat(show: _Show, live: Live, agent: str) -> AsyncIterator[str]:
    """Yield the events of a seat."""
    told: Any = None
    async for _ in show.rounds():
        now = await anyio.to_thread.run_sync(live.seat, agent)
        if now != told:
            told = now
            yield _event("seat", now)


def _stream(events: AsyncIterator[str]) -> Response:
    return StreamingResponse(events, media_type="text/event-stream", headers={"Cache-Control": "no-store"})


async def _message(request: Request) -> dict[str, Any]:
    """Return the JSON object of a request; raise HTTPException if its body is none, or too large."""
    if request.headers.get("content-type", "").partition(";")[0] != "application/json":
        raise HTTPException(415, "the content type must be application/json")
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _LARGEST_MESSAGE:
            raise HTTPException(413, f"a message has at most {_LARGEST_MESSAGE} bytes")
    try:
        given = json.loads(body)
    except (ValueError, RecursionError):
        given = None
    if not isinstance(given, dict):
        raise HTTPException(400, 'a message is a JSON object, for instance {"do": "pause"}')
    return given


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"error": error.detail}, error.status_code)


async def _failed(request: Request, error: Exception) -> Response:
    """Answer after an error of the server without its text, which may contain hidden values; the terminal shows it."""
    return JSONResponse({"error": "the server failed; its terminal shows the error"}, 500)


class _Pages:
    """Handlers of requests: pages, events and commands."""

    def __init__(self, show: _Show, tokens: Mapping[str, str] | None) -> None:
        self.show, self.tokens = show, tokens

    def allowed(self, request: Request, agent: str | None = None) -> None:
        """Check that a request has the token of the spectators, or of the seat.

        Raises:
            HTTPException: the token is wrong or missing.
        """
        if self.tokens is None:
            return
        given = request.query_params.get("token", "").encode()
        known = [self.tokens["watch"]] + ([self.tokens[agent]] if agent else [])
        if not any(hmac.compare_digest(given, token.encode()) for token in known):
            raise HTTPException(401, "wrong or missing token; open the address that the server has printed")

    def lab(self, request: Request) -> tuple[int, Live]:
        """Return number and laboratory of a path."""
        number = int(request.path_params["lab"])
        if number >= len(self.show.lives):
            raise HTTPException(404, f"there are laboratories 0 to {len(self.show.lives) - 1}")
        return number, self.show.lives[number]

    def seat(self, request: Request) -> tuple[Live, str]:
        """Return laboratory and agent of a path, after checking the token."""
        live, agent = self.lab(request)[1], request.path_params["agent"]
        if agent not in live.room.seats:
            raise HTTPException(404, f"seats: {', '.join(live.room.seats)}")
        self.allowed(request, agent)
        return live, agent

    async def home(self, request: Request) -> Response:
        """Return the first page: one laboratory, or two side by side."""
        self.allowed(request)
        if len(self.show.lives) == 1:
            return await self._spectators(0)
        query = html.escape(request.url.query)
        sources = [f'src="/lab/{number}?{query}"' for number in range(len(self.show.lives))]
        titles = [f"{number}: {policy}" for number, policy in enumerate(self.show.policies)]
        page = side_by_side(dict(zip(titles, sources, strict=True)), _FRAMED)
        return HTMLResponse(page, headers=_HEADERS)

    async def page(self, request: Request) -> Response:
        """Return the page of a laboratory."""
        number, _ = self.lab(request)
        self.allowed(request)
        return await self._spectators(number)

    async def _spectators(self, number: int) -> Response:
        page = await anyio.to_thread.run_sync(self.show.lives[number].page, number)
        return HTMLResponse(page, headers=_HEADERS)

    async def events(self, request: Request) -> Response:
        """Return the stream of a laboratory's events."""
        live = self.lab(request)[1]
        self.allowed(request)
        try:
            mark = [int(request.query_params.get(key, 0)) for key in ("turns", "shapes", "pool")]
        except ValueError:
            raise HTTPException(400, "turns, shapes and pool must be whole numbers") from None
        episode = request.query_params.get("episode", live.episode)
        return _stream(_film(self.show, live, [max(n, 0) for n in mark], episode))

    async def control(self, request: Request) -> Response:
        """Carry out a command in all laboratories."""
        self.allowed(request)
        try:
            await self.show.order(await _message(request))
        except ValueError as error:
            raise HTTPException(400, str(error)) from None
        return JSONResponse({})

    async def record(self, request: Request) -> Response:
        """Return the record of an episode that is over."""
        live = self.lab(request)[1]
        self.allowed(request)
        if not live.room.over:
            raise HTTPException(409, "the episode is not over; its record has the true contents")
        return FileResponse(live.room.record, filename=f"{live.room.scenario.name}-{live.seed}.jsonl")

    async def seat_page(self, request: Request) -> Response:
        """Return the page of a seat."""
        live, agent = self.seat(request)
        verbs = [
            {"name": verb.name, "meaning": verb.meaning, "arguments": [vars(one) for one in verb.arguments]}
            for verb in live.acts(agent)
        ]
        data = {
            "title": f"{agent}: {live.room.scenario.title}",
            "agent": agent,
            "brief": brief(live.room.laboratories, agent, None, str),
            "verbs": verbs,
            "seat": request.url.path,
        }
        return HTMLResponse(filled_page("seat.html", data, "'self'"), headers=_HEADERS)

    async def seat_events(self, request: Request) -> Response:
        """Return the stream of a seat's events."""
        return _stream(_seat(self.show, *self.seat(request)))

    async def seat_post(self, request: Request) -> Response:
        """Take or leave a seat, or play one of its turns."""
        live, agent = self.seat(request)
        given = await _message(request)
        answer: dict[str, Any] = {}
        if given.get("do") == "take":
            live.taken.add(agent)
        elif given.get("do") == "leave":
            live.taken.discard(agent)
        elif given.get("do") == "act":
            if agent not in live.taken:
                raise HTTPException(409, f"a policy plays {agent}; take the seat first")
            verb, arguments = given.get("verb"), given.get("arguments")
            known = arguments if isinstance(arguments, dict) else {}
            reply = await anyio.to_thread.run_sync(live.call, agent, str(verb), known)
            if reply.error:
                raise HTTPException(422, reply.text)
            answer = {"text": reply.text}
            await self.show.after(live)
        else:
            raise HTTPException(400, "do: must be take, leave or act")
        await self.show.tell()
        return JSONResponse(answer)


def live_app(
    lives: Sequence[Live],
    policies: Sequence[str],
    tokens: Mapping[str, str] | None = None,
    hosts: Sequence[str] = LOCAL,
    paused: bool = False,
    speed: int = 6,
) -> Starlette:
    """Return the web application of one or two laboratories.

    Args:
        lives: the laboratories, which have common controls.
        policies: displayed name of the policies of each laboratory.
        tokens: tokens of the spectators (``watch``) and of each seat, given as ``?token=``; spectators may take any
            seat. None: no tokens; everyone who can reach the server may watch and play.
        hosts: accepted host names; ``*`` accepts any.
        paused: True if the laboratories are paused at first.
        speed: turns per second.
    """
    show = _Show(lives, policies, paused, speed)
    pages = _Pages(show, tokens)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(show.run(live)) for live in lives]
        yield
        for task in tasks:
            task.cancel()
        for live in lives:
            live.room.close()

    routes: list[tuple[str, Callable[[Request], Any], str]] = [
        ("/", pages.home, "GET"),
        ("/control", pages.control, "POST"),
        ("/lab/{lab:int}", pages.page, "GET"),
        ("/lab/{lab:int}/events", pages.events, "GET"),
        ("/lab/{lab:int}/record", pages.record, "GET"),
        ("/lab/{lab:int}/seat/{agent}", pages.seat_page, "GET"),
        ("/lab/{lab:int}/seat/{agent}", pages.seat_post, "POST"),
        ("/lab/{lab:int}/seat/{agent}/events", pages.seat_events, "GET"),
    ]
    app = Starlette(
        routes=[Route(path, answer, methods=[method]) for path, answer, method in routes],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=list(hosts))],
        exception_handlers={HTTPException: _refused, Exception: _failed},
        lifespan=lifespan,
    )
    app.state.show = show
    return app


def live_server(app: Starlette, host: str, port: int) -> uvicorn.Server:
    """Return a server of a :func:`live_app`."""
    # uvicorn's own logging configuration would close the handlers of the whole process.
    config = uvicorn.Config(
        app, host=host, port=port, log_config=None, log_level="warning", timeout_graceful_shutdown=3
    )
    server = app.state.show.server = uvicorn.Server(config)
    return server
