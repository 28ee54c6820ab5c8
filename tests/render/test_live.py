"""The live pages: watched to the end, played by clicks and by keys, by several visitors, and attacked."""

import asyncio
import http.client
import json
import logging
import re
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from helpers import slow_but, until

from chemlab.agents.policies import agent_policy
from chemlab.cli.servers import _free_port
from chemlab.config.loading import load_scenario
from chemlab.record import read_record, verify_record

pytest.importorskip("starlette", reason="needs the extra live")
pytest.importorskip("uvicorn", reason="needs the extra live")
live = pytest.importorskip("chemlab.agents.live")

NAME = "wurtz_dodecane_direct"


class Served:
    """A server in a thread of its own, and its laboratories."""

    def __init__(self, folder: Path, policies: list[str], tokens: dict[str, str] | None, **options: Any) -> None:
        spec, own = load_scenario(NAME), enumerate(policies)
        self.lives = [live.Live(spec, policy, 0, "train", folder / str(i)) for i, policy in own]
        self.port = _free_port("127.0.0.1")
        self.url = f"http://127.0.0.1:{self.port}"
        app = live.live_app(self.lives, policies, tokens, **options)
        self.server = live.live_server(app, "127.0.0.1", self.port)
        self.thread = threading.Thread(target=self.server.run, daemon=True)

    def ask(self, method: str, path: str, body: bytes = b"", **headers: str) -> tuple[int, bytes]:
        """(status, body) of a request; a stream is read up to its first event."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            connection.request(method, path, body, headers)
            answer = connection.getresponse()
            events = answer.getheader("content-type", "").startswith("text/event-stream")
            return answer.status, answer.read(6) if events else answer.read()
        finally:
            connection.close()

    def order(self, path: str = "/control", **message: Any) -> tuple[int, Any]:
        """(status, JSON) of a message."""
        status, body = self.ask("POST", path, json.dumps(message).encode(), **{"Content-Type": "application/json"})
        return status, json.loads(body)


@contextmanager
def served(
    folder: Path, policies: tuple[str, ...] = ("scripted",), tokens: dict[str, str] | None = None, **options: Any
) -> Iterator[Served]:
    found = Served(folder, list(policies), tokens, **options)
    found.thread.start()
    try:
        until(lambda: found.server.started)
        yield found
    finally:
        found.server.should_exit = True
        found.thread.join(20)
        assert not found.thread.is_alive()


def test_an_episode_is_watched_to_its_end(tmp_path: Path, visitor: Any) -> None:
    """Two visitors see the same; one pauses, and it stands still for both; then the record is right."""
    with served(tmp_path, paused=True, speed=2) as lab:
        one, other = visitor(lab.url), visitor(lab.url)
        one.get_by_role("button", name="Run").click()
        one.get_by_role("button", name="Pause").click()
        until(lambda: not one.evaluate("live.playing"))
        time.sleep(1.0)  # a turn that had begun is over, and known to both
        before = lab.lives[0].film.turns
        assert one.evaluate("count") == other.evaluate("count") == before
        one.locator("#forward").click()
        until(lambda: other.evaluate("count") == before + 1)
        other.get_by_label("Speed").select_option("60")
        other.keyboard.press(" ")
        for page in (one, other):
            page.get_by_text("record verified").wait_for()
            assert page.evaluate("count") == lab.lives[0].film.turns
        with one.expect_download() as download:
            one.get_by_role("button", name="Download record").click()
        copy = tmp_path / "copy.jsonl"
        download.value.save_as(copy)
        assert verify_record(copy).status == "ok"
        one.keyboard.press("N")  # with the caps lock, for instance
        for page in (one, other):
            page.get_by_text("seed 1").wait_for()


def _fullest(lab: Served) -> int:
    """The slot with most of the product."""
    shelf = lab.lives[0].room.laboratories.shelf
    slots = lab.lives[0].room.scenario.shelf.slots
    return max(range(slots), key=lambda slot: shelf.vessel(0, slot).amounts(0.0).get("dodecane", 0.0))


def test_an_episode_is_played_by_keys(tmp_path: Path, visitor: Any) -> None:
    """From taking the seat to the end, no pointer is used."""
    with served(tmp_path, paused=True, speed=60) as lab:
        seat = visitor(f"{lab.url}/lab/0/seat/manager_0")

        def press(name: str) -> None:
            """Go to a button by the tabulator, and press it."""
            for _ in range(60):
                if seat.evaluate("document.activeElement.textContent") == name:
                    break
                seat.keyboard.press("Tab")
            else:
                raise AssertionError(f"the keyboard does not reach {name}")
            seat.keyboard.press("Enter")

        seat.evaluate("now = null")  # as before the first news
        press("Take this seat")
        until(lambda: "manager_0" in lab.lives[0].taken)
        lab.order(do="play")
        for verb, moves in (("start", 0), ("wait", 0), ("start", 1), ("wait", 0), ("submit", _fullest)):
            seat.get_by_text("It is your turn.").wait_for()
            turns = lab.lives[0].film.turns
            if verb != "wait":
                field = "bench" if verb == "start" else "slot"
                for _ in range(60):
                    form = f"""document.querySelector("form[data-verb='{verb}']")"""
                    if seat.evaluate(f"document.activeElement === {form}.{field}"):
                        break
                    seat.keyboard.press("Tab")
                for _ in range(moves if isinstance(moves, int) else moves(lab)):
                    seat.keyboard.press("ArrowDown")
            press(verb)
            until(lambda turns=turns: lab.lives[0].film.turns > turns)
            until(lambda: lab.lives[0].turn in ("", "manager_0"))
        seat.get_by_text("The episode is over.").first.wait_for()
        press("Give the seat back")  # before another episode begins
        until(lambda: not lab.lives[0].taken)
        until(lambda: lab.lives[0].verdict[0] != "")
        assert lab.lives[0].verdict[0] == "ok"
        assert read_record(lab.lives[0].room.record).end is not None
        assert lab.lives[0].room.report()["seats"]["manager_0"]["wrong"] == 0


def test_a_seat_shows_the_verbs_that_are_possible(tmp_path: Path, visitor: Any) -> None:
    with served(tmp_path, paused=True) as lab:
        lab.order("/lab/0/seat/manager_0", do="take")
        seat = visitor(f"{lab.url}/lab/0/seat/manager_0")
        seat.get_by_text("It is your turn.").wait_for()
        assert seat.locator("#verbs button:visible").all_inner_texts() == ["start", "measure", "discard", "submit"]


@pytest.mark.parametrize("width", [1280, 390])
def test_nothing_is_cut_or_overlaps(tmp_path: Path, visitor: Any, width: int) -> None:
    with served(tmp_path, paused=True) as lab:
        lab.order("/lab/0/seat/rxn_0", do="take")
        for address in ("/", "/lab/0/seat/manager_0", "/lab/0/seat/rxn_0"):
            page = visitor(lab.url + address, width=width)
            if address == "/":
                goal = page.locator(".bench > button > span").first
                goal.evaluate("e => e.textContent = 'ortho_pyrrolidinyl, 58/60'")
                marks = page.locator("#rewards svg text", has_text=re.compile("start|tick")).all_text_contents()
                assert marks == ["start"], "no labels over each other before the first turn"
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth + 1"), address
            cut = page.evaluate(
                """[...document.querySelectorAll("button, label, select, td, th, h1, h2")].filter(e => {
                const box = e.getBoundingClientRect();
                const narrow = e.tagName === "BUTTON" && e.scrollWidth > e.clientWidth + 2;
                return box.width && (box.right > innerWidth + 1 || narrow);
                }).map(e => e.textContent.slice(0, 40))"""
            )
            assert cut == [], address
        assert "change of the temperature in K, -15 to 15" in page.inner_text("#verbs")
        assert "All other agents: policies or people" in page.inner_text("#brief")


def test_two_laboratories_stand_side_by_side(tmp_path: Path, visitor: Any) -> None:
    """The same seed, controlled together."""
    with served(tmp_path, ("scripted", "random"), paused=True, speed=60) as lab:
        page = visitor(lab.url)
        assert page.locator("iframe").count() == 2
        for number in range(2):
            page.frame_locator("iframe").nth(number).get_by_role("button", name="Run").wait_for()
        page.frame_locator("iframe").nth(0).locator("#forward").click()
        until(lambda: [one.film.turns for one in lab.lives] == [1, 1])
        assert [one.seed for one in lab.lives] == [0, 0]
        lab.lives[0].seed = 2**60 + 1
        assert visitor(f"{lab.url}/lab/0").get_by_text(f"seed {2**60 + 1} ").count() == 1, "all its digits"


_HIDE = """Object.defineProperty(document, 'hidden', {value: %s, configurable: true});
document.dispatchEvent(new Event('visibilitychange'))"""


def test_hidden_pages_leave_connections_to_others(tmp_path: Path, visitor: Any) -> None:
    """A browser has six to a server; a page that is shown again has missed nothing."""
    with served(tmp_path, paused=True) as lab:
        pages = [visitor(lab.url) for _ in range(6)]
        for page in pages:
            page.evaluate(_HIDE % "true")
        watching = visitor(lab.url)
        watching.locator("#forward").click()
        until(lambda: watching.evaluate("count") == 1)
        pages[0].evaluate(_HIDE % "false")
        until(lambda: pages[0].evaluate("count") == 1)
        assert pages[1].evaluate("count") == 0


def test_a_lost_connection_is_opened_again(tmp_path: Path, visitor: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both pages say that it is lost until it is there again; a link to a seat keeps the focus meanwhile."""

    async def once(show: Any) -> Any:
        yield

    with served(tmp_path, paused=True) as lab:
        with monkeypatch.context() as patch:
            patch.setattr(live._Show, "rounds", once)
            watching, seat = visitor(lab.url), visitor(f"{lab.url}/lab/0/seat/manager_0")
            watching.get_by_text("take seat").first.focus()
            for page in (watching, seat):
                page.get_by_text("The connection is lost").wait_for()
        lab.lives[0].step()
        for page in (watching, seat):
            page.get_by_text("The connection is lost").wait_for(state="detached")
        assert watching.evaluate("[count, document.activeElement.textContent]") == [1, "take seat"]
        assert seat.locator("#status").get_attribute("aria-live") == "off", "while policies play"


def taken_seat(lab: Any, visitor: Any) -> tuple[Any, int]:
    """The page of the reaction bench's seat at its first turn, taken by a person, and the turns before."""
    while lab.lives[0].turn != "rxn_0":
        lab.lives[0].step()
    turns = lab.lives[0].film.turns
    lab.order("/lab/0/seat/rxn_0", do="take")
    seat = visitor(f"{lab.url}/lab/0/seat/rxn_0")
    seat.get_by_text("It is your turn.").wait_for()
    assert seat.locator("#status").get_attribute("aria-live") == "polite"
    return seat, turns


def test_an_empty_number_is_not_zero(tmp_path: Path, visitor: Any) -> None:
    with served(tmp_path, paused=True) as lab:
        seat, turns = taken_seat(lab, visitor)
        field, button = seat.locator("input[name=temperature_change]"), seat.get_by_role("button", name="step")
        field.fill("")
        button.click()
        assert field.evaluate("e => e.validity.valueMissing")
        field.fill("5")
        button.click()
        until(lambda: lab.lives[0].film.turns > turns)
        assert [turn["plays"] for turn in lab.lives[0].film.since(turns)["turns"]] == [[[1, "temperature up 33%"]]]


def test_a_double_click_is_one_turn(tmp_path: Path, visitor: Any) -> None:
    """Nor does a page act on an observation that it does not show."""
    with served(tmp_path, paused=True) as lab:
        seat, turns = taken_seat(lab, visitor)
        seat.evaluate("for (let i = 0; i < 2; i++) document.querySelector('form button').click()")
        until(lambda: lab.lives[0].film.turns > turns)
        time.sleep(0.5)
        assert lab.lives[0].film.turns == turns + 1


def test_a_seat_is_sent_what_its_agent_observes(tmp_path: Path) -> None:
    """Neither contents nor hidden parameters, although the spectators' page has both."""
    room = live.Live(load_scenario("unlabelled"), "scripted", 0, "train", tmp_path)
    room.step()
    for agent in room.room.seats:
        assert "contents" not in json.dumps(room.seat(agent))
        assert room.seat(agent)["text"] == room.room.display(agent)
    assert '"hidden":[["' in room.page(0)
    assert '"contents"' in room.page(0)
    room.room.close()


def test_a_policy_plays_unless_a_person_has_the_seat(tmp_path: Path) -> None:
    """A person who takes the seat in mid-episode goes on, and gives it back; refused actions change nothing."""
    lab = live.Live(load_scenario(NAME), "scripted", 0, "train", tmp_path)
    for _ in range(3):
        lab.step()
    lab.taken.add(lab.turn)
    turn, turns = lab.turn, lab.film.turns
    lab.step()
    assert (lab.turn, lab.film.turns) == (turn, turns)
    assert lab.call(turn, "nonsense", {}).error
    assert lab.film.turns == turns
    lab.taken.clear()
    while not lab.room.over:
        lab.step()
    lab.check()
    assert lab.verdict[0] == "ok"
    assert set(read_record(lab.room.record).header["policies"].values()) == {"scripted"}


@pytest.mark.parametrize(
    ("scenario", "seat"),
    slow_but(
        [("wurtz_dodecane", "ext_0"), ("recrystallization", "cry_0"), ("wurtz_real", "dit_0"), ("wurtz_real", "ext_0")],
        ("wurtz_dodecane", "ext_0"),
    ),
)
def test_a_policy_goes_on_where_a_person_began(scenario: str, seat: str, tmp_path: Path) -> None:
    """It begins at its own first turn, not where it was in another experiment, and knows the number after that."""
    lab = live.Live(load_scenario(scenario), "scripted", 0, "train", tmp_path)
    while lab.turn != seat:
        lab.step()
    lab.taken.add(seat)
    labs = lab.room.laboratories
    number, members = labs.agents.index(seat), labs.members
    mask = labs.mask(number, members)
    action = next(int(a) for a in mask[0].nonzero()[0] if a != labs.roles[number].workplace.end_action)
    lab.room.call = lambda agent, verb, arguments: lab.room.play(agent, action)  # type: ignore[method-assign]
    lab.call(seat, "", {})
    lab.taken.clear()
    policy, steps = lab._players._policies[number], []
    act = policy.act
    policy.act = lambda seen, mask, step, members: (steps.append(int(step[0])), act(seen, mask, step, members))[1]
    while len(steps) < 3:
        lab.step()
    assert steps[:2] == [0, 2]
    alone = agent_policy("scripted", labs, number)
    assert len(alone.act(labs.observe(number, members), mask, members + 1, members)) == 1
    lab.room.close()


def test_a_page_has_the_film_of_its_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also while another one begins: it waits."""
    lab, pages = live.Live(load_scenario(NAME), "scripted", 0, "train", tmp_path), list[str]()
    lab.step()
    made = live.Film
    asker = threading.Thread(target=lambda: pages.append(lab.page(0)))

    def slowly(labs: Any) -> Any:
        asker.start()
        asker.join(0.2)
        return made(labs)

    monkeypatch.setattr(live, "Film", slowly)
    lab.begin(1)
    asker.join()
    assert f'"episode":"{lab.episode}"' in pages[0]
    assert '"turns":[]' in pages[0].replace(" ", "")
    lab.room.close()


def test_a_verdict_is_of_the_episode_that_was_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lab, verify = live.Live(load_scenario(NAME), "scripted", 0, "train", tmp_path), live.verify_record
    while not lab.room.over:
        lab.step()

    def slowly(*given: Any) -> Any:
        found = verify(*given)
        lab.begin(1)  # somebody presses "new" meanwhile
        return found

    monkeypatch.setattr(live, "verify_record", slowly)
    episode = lab.episode
    lab.check()
    assert lab.episode != episode
    assert lab.verdict == ("", "")
    lab.check()  # which was asked for before
    assert lab.verdict == ("", "")


def test_failures_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """A policy that fails pauses its laboratory, and the server goes on."""
    with served(tmp_path, paused=True) as lab:
        broken, works = lab.lives[0], lab.lives[0].step
        broken.step = Mock(side_effect=KeyError("beaker"))
        show = lab.server.config.app.state.show
        lab.order(do="play")
        until(lambda: show.status(broken)["words"] == "KeyError: 'beaker'")
        assert not show.playing
        broken.step = works
        lab.order(do="step")
        until(lambda: broken.film.turns > 0)
        assert "beaker" not in show.status(broken)["words"]
        monkeypatch.setattr(live.Live, "begin", Mock(side_effect=OSError("disk full")))
        assert lab.order(do="new") == (500, {"error": "the server failed; its terminal shows the error"})
    assert "KeyError: 'beaker'" in capsys.readouterr().err


@pytest.mark.parametrize("split", ["train", "private:" + "5" * 32])
def test_an_own_scenario_is_played_right(split: str, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('base = "unlabelled"\nname = "mine"\nsummary = ""\n')
    lab = live.Live(load_scenario(tmp_path / "mine.toml"), "random", 0, split, tmp_path)
    lab.step(10_000)
    lab.check()
    assert lab.verdict[0] == "ok"
    assert lab.words()[0] == f"over: score {lab.room.score:.3f}; record verified".replace("-", "\u2212")
    assert lab.room.score < 0.0
    assert "5" * 32 not in (tmp_path / "ledger.jsonl").read_text(), "the salt of a private split"


def test_an_episode_too_long_for_a_page_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "MOST_TURNS", 2)
    lab = live.Live(load_scenario(NAME), "scripted", 0, "train", tmp_path)
    lab.step(5)
    assert lab.film.turns == 2
    assert lab.words() == ("stopped: a page shows at most 2 turns; begin a new episode", "warn")
    lab.room.close()


def test_a_server_leaves_the_logging_of_its_process_alone(tmp_path: Path) -> None:
    with (tmp_path / "log.txt").open("w", encoding="utf-8") as stream:
        handler = logging.StreamHandler(stream)
        handler.close = stream.close  # as absl's handler does
        with served(tmp_path, paused=True):
            assert not stream.closed


def test_a_policy_may_play_what_is_not_possible(tmp_path: Path) -> None:
    """As in the environments, its turn is lost, and the laboratory goes on."""
    lab = live.Live(load_scenario(NAME), "scripted", 0, "train", tmp_path)
    labs = lab.room.laboratories
    illegal = int(labs.mask(0, labs.members)[0].argmin())
    before = labs.shelf.vessels.copy()
    lab.room.play("manager_0", illegal)
    assert lab.film.since()["turns"][0]["lost"] == ["manager_0"]
    assert (labs.shelf.vessels == before).all()
    while not lab.room.over:
        lab.step()


def test_malformed_messages_change_nothing(tmp_path: Path) -> None:
    with served(tmp_path, paused=True) as lab:
        before = lab.lives[0].film.turns, set(lab.lives[0].taken)
        for path, body, status in (
            ("/control", b"{", 400),
            ("/control", b"[" * 5000, 400),
            ("/control", b"[1]", 400),
            ("/control", b'{"do": "explode"}', 400),
            ("/control", b'{"do": "speed", "value": "fast"}', 400),
            ("/control", b"{" + b" " * 20_000 + b"}", 413),
            ("/lab/7/seat/rxn_0", b'{"do": "take"}', 404),
            ("/lab/0/seat/nobody", b'{"do": "take"}', 404),
            ("/lab/0/seat/rxn_0", b'{"do": "act", "verb": "step"}', 409),
            ("/nowhere", b"{}", 404),
        ):
            found, answer = lab.ask("POST", path, body, **{"Content-Type": "application/json"})
            assert (found, b"Traceback" in answer) == (status, False), (path, body[:40])
        assert lab.ask("POST", "/control", b'{"do": "pause"}', **{"Content-Type": "text/plain"})[0] == 415
        assert before == (lab.lives[0].film.turns, lab.lives[0].taken)


def test_tokens_and_hosts(tmp_path: Path) -> None:
    """A seat's token opens its seat alone; a page of another name does not reach the server; it survives all that."""
    tokens = {"watch": "w" * 20, "manager_0": "m" * 20, "rxn_0": "r" * 20, "dit_0": "d" * 20}
    with served(tmp_path, tokens=tokens, paused=True) as lab:
        for token, expected in (("", 401), ("x", 401), ("é", 401), (tokens["rxn_0"], 401), (tokens["watch"], 200)):
            query = f"?token={token}".encode().decode("latin-1") if token.isascii() else "?token=%C3%A9"
            for path in ("/", "/lab/0", "/lab/0/events"):
                assert lab.ask("GET", path + query)[0] == expected, path
        for agent in ("manager_0", "rxn_0", "dit_0"):
            found = lab.ask("GET", f"/lab/0/seat/{agent}?token={tokens['rxn_0']}")[0]
            assert found == (200 if agent == "rxn_0" else 401)
        page = lab.ask("GET", f"/lab/0/seat/rxn_0?token={tokens['rxn_0']}")[1]
        assert b'"seed"' not in page
        assert b", seed " not in page
        assert lab.ask("GET", f"/lab/0?token={tokens['watch']}", Host="evil.example")[0] == 400
        assert lab.ask("GET", f"/lab/0/record?token={tokens['watch']}")[0] == 409
        assert lab.ask("GET", f"/lab/0/events?token={tokens['watch']}&turns=many")[0] == 400


def test_a_page_that_is_closed_while_news_are_told_stops_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """A waiter that is cut off twice released the lock of another, and all pages stood still."""
    monkeypatch.setattr(live, "_NEWS_S", 0.0)

    async def story(steps: int) -> None:
        show = live._Show([], [], True, 1)
        rounds = show.rounds()
        await anext(rounds)
        waiting = asyncio.ensure_future(anext(rounds))
        await asyncio.sleep(0.01)
        async with show.changed:
            waiting.cancel()
            await asyncio.sleep(0.01)
            waiting.cancel()
            for _ in range(steps):
                await asyncio.sleep(0)
        with suppress(asyncio.CancelledError):
            await waiting
        await asyncio.wait_for(show.tell(), 60)

    with ThreadPoolExecutor(1) as thread:  # in this one, the browser's loop runs
        for steps in range(6):
            thread.submit(asyncio.run, story(steps)).result()
