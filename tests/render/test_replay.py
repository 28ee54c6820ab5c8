"""The replay page: complete, small, and in a browser what it says it is."""

import base64
import hashlib
import json
import os
import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import command, mapping, record_episode, refused
from PIL import Image

from chemlab.agents.seats import Room
from chemlab.config.loading import dump_scenario, load_scenario, restore_scenario
from chemlab.envs.aec import raw_env
from chemlab.lab.engine import Laboratories
from chemlab.physics.transfer import liquid_volume
from chemlab.record import LIMITS, Recorder, RecordError, Replay, read_record
from chemlab.render.animation import animation
from chemlab.render.draw import draw
from chemlab.render.protocol import protocol
from chemlab.render.replay_page import replay_data, replay_page
from chemlab.render.scene import laboratory_scene


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_episode(tmp_path_factory.mktemp("episode") / "a.jsonl", seed=0)


@pytest.fixture(scope="module")
def page_file(episode: Path) -> Path:
    path = episode.with_suffix(".html")
    path.write_text(replay_page(read_record(episode)), encoding="utf-8")
    return path


def unpack(data: dict[str, Any], value: Any) -> Any:
    """What the page's own ``unpack`` does."""
    if not isinstance(value, (list, tuple)):
        return value
    if value[0] == -2:
        return unpack(data, data["pool"][value[1]])
    if value[0] == -1:
        return [unpack(data, item) for item in value[1:]]
    return {key: unpack(data, item) for key, item in zip(data["shapes"][value[0]], value[1:], strict=True)}


@pytest.mark.parametrize("slots", [8, 40])
def test_frames_are_the_laboratory_after_each_turn(slots: int, episode: Path, tmp_path: Path) -> None:
    """Whatever is asked for: contents, steps and costs are those of the simulator at that turn."""
    if slots > 8:
        (tmp_path / "many.toml").write_text(f'base = "salt_from_oil"\n[shelf]\nslots = {slots}\n')
        episode = record_episode(tmp_path / "many.jsonl", tmp_path / "many.toml")
    found = read_record(episode)
    data = replay_data(found)
    assert len(data["frames"]) == len(found.turns) + 1 == len(data["turns"]) + 1
    replay = Replay(found)
    labs: Laboratories = replay.laboratories
    for i, turn in enumerate([None, *found.turns]):
        if turn is not None:
            replay.play(turn)
        frame = unpack(data, data["frames"][i])
        assert frame["ticks"] == labs.state.ticks[0]
        assert data["costs"][i] == pytest.approx(list(labs.costs().values()), rel=1e-6, abs=1e-9)
        for slot, picture in enumerate(frame["shelf"]):
            vessel = labs.shelf.vessel(0, slot)
            assert (picture["vessel"] is not None) == vessel.present
            if vessel.present:
                assert dict(picture["vessel"]["contents"]) == pytest.approx(vessel.amounts(5e-6), rel=1e-3)
        litres = [liquid_volume(row, labs.shelf.chem()) for row in labs.shelf.vessels[0]]
        assert [one for (one,) in frame["liquid_l"]] == pytest.approx(litres, rel=1e-3, abs=1e-9)
        for bench, experiments in zip(frame["benches"], labs.experiments, strict=True):
            assert bench["busy"] == experiments.busy[0]
    assert data["results"][-1] == pytest.approx(found.end["end"]["score"], rel=1e-6)
    # Each experiment once, with its score; the scores are the benches' rewards.
    for agent, total in found.end["end"]["rewards"].items():
        scores = [e["score"] for e in data["experiments"] if e["agent"] == agent]
        assert agent == "manager_0" or sum(scores) == pytest.approx(total, abs=1e-5)


def test_the_score_now_counts_submissions_that_agents_hear_of_later(tmp_path: Path) -> None:
    data = replay_data(read_record(record_episode(tmp_path / "rush.jsonl", "rush", seed=2**60 + 1)))
    assert data["seed"] == str(2**60 + 1), "JavaScript would round it"
    first = next(t for t, turn in enumerate(data["turns"], start=1) if turn["kind"] == "submit")
    assert first < len(data["turns"])
    assert data["results"][first] > data["results"][first - 1] + 0.01


def test_every_decision_of_the_manager_is_in_words(episode: Path) -> None:
    data = replay_data(read_record(episode))
    decisions = [turn for turn in data["turns"] if turn["kind"]]
    assert len(decisions) == unpack(data, data["frames"][-1])["manager_actions"]
    assert decisions[0]["plays"] == [[0, "start rxn_0 on slot 0, goal dodecane"]]
    assert re.search(r"\d\.\d{3} mol dodecane at purity", decisions[-1]["outcome"])
    assert any("dodecane" in turn["outcome"] for turn in decisions if turn["kind"] == "measure")


def test_pages_are_small_and_ask_nothing_of_a_network(tmp_path: Path) -> None:
    found = read_record(record_episode(tmp_path / "a.jsonl", "wurtz_two_lines", "scripted", 1))
    text, ticks = replay_page(found), max(found.turns[-1]["tick"], 20)
    assert len(text.encode()) < 100_000 + 1_900_000 * ticks / 200
    assert not re.search(r"""(?:src|href)=["'](?!data:)""", text)
    assert '<noscript><p class="card warn">This page needs JavaScript.</p></noscript>' in text
    own = text.split('type="application/json"')[0]
    assert "http" not in re.sub(r"http://www\.w3\.org/2000/svg|http-equiv", "", own)


def test_names_cannot_break_out_of_the_page(episode: Path, tmp_path: Path) -> None:
    """Text of a scenario is data in the page, whatever stands in it."""
    found = read_record(episode)
    evil = "</script><script>alert(1)</script><!-- <b> & \u2028 __DATA__"
    data = dump_scenario(raw_env("wurtz_dodecane").scenario)
    data["scenario"]["title"] = evil
    text = replay_page(read_record(record_episode(tmp_path / "evil.jsonl", restore_scenario(data, "test"), seed=0)))
    assert len(re.findall(r"</script", text)) == len(re.findall(r"</script", replay_page(found))) == 2
    assert "<!--" not in text
    inside = text.split('type="application/json">')[1].split("</script>")[0]
    assert json.loads(inside)["title"] == evil


def test_the_page_allows_its_own_script_and_nothing_else(episode: Path) -> None:
    """Its policy has the hashes of what stands in it, and no way around them (Content Security Policy 3)."""
    text = replay_page(read_record(episode))
    (policy,) = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)">', text)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    hashes = {}
    for element in ("script", "style"):
        (content,) = re.findall(f"<{element}>(.*?)</{element}>", text, flags=re.DOTALL)
        hashes[element] = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
    own = {f"{element}-src": f"'sha256-{value}'" for element, value in hashes.items()}
    none = dict.fromkeys(("default-src", "connect-src", "form-action", "base-uri"), "'none'")
    assert rules == own | none | {"img-src": "data:"}
    # Attributes with style or code in them would be refused.
    assert not re.search(r"""<[^>]*\s(?:style|on\w+)=""", text.split('<script id="data"')[0])


def test_an_unfinished_record_has_a_page(episode: Path, tmp_path: Path) -> None:
    part = tmp_path / "a.jsonl.part"
    part.write_bytes(b"".join(episode.read_bytes().splitlines(keepends=True)[:31]) + b'{"turn"')
    output = tmp_path / "page.html"
    assert "the available turns are shown" in command("replay", part, "-o", output)
    data = json.loads(output.read_text().split('type="application/json">')[1].split("</script>")[0])
    assert len(data["turns"]) == 30
    assert data["verified"]["status"] == "torn"
    # What the user has is not written over unasked.
    command("replay", part, "-o", output, code=2)
    command("replay", part, "-o", output, "--force")
    command("replay", output, code=2)


def test_a_record_has_a_protocol(episode: Path, tmp_path: Path) -> None:
    """Every action is in it, and all that was taken from the stock."""
    output = tmp_path / "protocol.md"
    said = command("replay", episode, "-o", output)
    assert f" turns, {output.stat().st_size / 1000:.1f} kB" in said
    text = output.read_text(encoding="utf-8")
    steps = [line for line in text.splitlines() if line.startswith("- tick ")]
    times = [int(found[1]) if (found := re.search(r" \((\d+) times\)\.", line)) else 1 for line in steps]
    whole = read_record(episode)
    assert sum(times) == sum(len(turn["play"]) for turn in whole.turns)
    replay = Replay(whole)
    labs, before = replay.laboratories, replay.laboratories.shelf.stock[0].copy()
    for turn in whole.turns:
        replay.play(turn)
    for name, used in zip(labs.shelf.layout.materials, (before - labs.shelf.stock[0]).tolist(), strict=True):
        amounts = [float(mol) for line in steps for mol in re.findall(rf"([\d.e-]+) mol `{re.escape(name)}`", line)]
        assert sum(amounts) == pytest.approx(used, rel=1e-4, abs=1e-6)
    assert f"- score {float(labs.result(labs.members)[0]):.4f}" in text
    assert any(" Read: " in line for line in steps) == any(" measure " in line for line in steps)
    assert re.search(r"Then \d+\.\d K, \d\.\d+ L\.", text)
    again = read_record(record_episode(tmp_path / "again.jsonl", "failing", "scripted", seed=0))
    ended = [f"{score:+.3f}" for turn in again.turns for score in turn.get("scores", {}).values()]
    assert sorted(re.findall(r" over: bench score (.*)\.\n", protocol(again))) == sorted(ended), (
        "experiments of equal actions"
    )


@pytest.mark.parametrize(
    ("summary", "shown"),
    [
        ("Sodium to salt", "Sodium to salt."),  # ends with a full stop
        ("<script>a</script>", "&lt;script>a&lt;/script>."),
        ("[here](javascript:a)", r"[here]\(javascript:a)."),
        ("[here]\n\n[here]: javascript:a", "[here]  [here]: javascript:a."),  # a reference begins a line
    ],
)
def test_the_summary_of_a_protocol_is_a_text(summary: str, shown: str, tmp_path: Path) -> None:
    env = raw_env(load_scenario(mapping("wurtz_dodecane_direct") | {"summary": summary}))
    with Recorder(tmp_path / "a.jsonl", env.laboratories) as recorder:
        env.reset(seed=0)
        recorder.begin(0)
    assert f"\n{shown} Simulated by chemlab" in protocol(read_record(recorder.part))


def test_a_record_that_cannot_go_on(episode: Path, tmp_path: Path) -> None:
    """The page shows what can be played, and says so."""
    lines = episode.read_text().splitlines()
    turn = json.loads(lines[20])
    turn["play"] = {"nobody": ["", 0]}
    path = tmp_path / "a.jsonl"
    path.write_text("\n".join([*lines[:20], json.dumps(turn), *lines[21:]]) + "\n")
    data = replay_data(read_record(path))
    assert len(data["turns"]) == 19
    assert "nobody" in data["stopped"]
    assert data["verified"]["status"] == "tampered"


@pytest.fixture(scope="module")
def called(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A seat's episode: a refused call, a free one, and one with a reason, in which nothing is markup."""
    folder = tmp_path_factory.mktemp("called")
    room = Room("unlabelled", folder=folder)
    room.call("manager_0", "measure", {"slot": 77, "instrument": "uv_vis"})
    room.call("manager_0", "look")
    room.call("manager_0", "measure", {"slot": 1, "instrument": "uv_vis", "reason": "<b>acid?</b>"})
    room.call("manager_0", "discard", {"slot": 1})
    room.close()
    return folder / "episode-0000.jsonl.part"


def test_calls_stand_beside_the_turns(called: Path) -> None:
    data = replay_data(read_record(called))
    calls = data["calls"]
    assert [call[:4] for call in calls] == [
        [0, "manager_0", "measure slot=77 instrument=uv_vis", ""],
        [0, "manager_0", "look", ""],
        [1, "manager_0", "measure slot=1 instrument=uv_vis", "<b>acid?</b>"],
        [2, "manager_0", "discard slot=1", ""],
    ]
    assert [call[5] for call in calls] == [True, False, False, False]
    assert data["turns"][0]["plays"][0][1] == "measure slot 1 with uv_vis"
    transcript = called.with_name("episode-0000.transcript.jsonl")
    text = transcript.read_text()
    for content, said in (
        (b"{}\n[]\n", "is not a transcript"),
        (b"\xff\xfe", r"transcript\.jsonl: not UTF-8.*move it away"),
        (None, r"transcript\.jsonl: is larger than .*move it away"),
    ):
        transcript.write_bytes(content or b"")
        if content is None:
            os.truncate(transcript, LIMITS.file_bytes + 1)
        refused(said, replay_page, read_record(called))
    transcript.write_text(text)


def turn_of(path: Path, agent: str, number: int = 8) -> int:
    """The turn of an agent's action, the eighth of the episode: it is in the middle of an experiment then."""
    return [i for i, turn in enumerate(read_record(path).turns, start=1) if agent in turn["play"]][number - 1]


@pytest.fixture
def page(visitor: Any, page_file: Path, episode: Path) -> Any:
    """The page, opened at a turn of the extraction bench; anything on the console is a failure."""
    return visitor(f"{page_file.as_uri()}#{turn_of(episode, 'ext_0')}")


def test_calls_are_shown_as_text(browser: Any, called: Path, page: Any) -> None:
    assert page.locator("#calls-card").is_hidden(), "there is no transcript"
    file = called.parent / "page.html"
    file.write_text(replay_page(read_record(called)), encoding="utf-8")
    own = browser.new_page()
    own.goto(file.as_uri())
    assert own.locator("#calls > div").count() == 2
    assert "slot must be one of 0, 1" in own.locator("#calls .warn").inner_text()
    own.keyboard.press("ArrowRight")
    own.wait_for_function("document.querySelectorAll('#calls > div').length === 3")
    assert "<b>acid?</b>" in own.locator("#calls > div").first.inner_text()
    own.close()


def test_no_other_script_runs(browser: Any, page_file: Path) -> None:
    """Not even if something did get into the page as markup."""
    page = browser.new_page()
    page.goto(page_file.as_uri())
    page.wait_for_selector("#slots svg")
    page.evaluate(
        """() => { const script = document.createElement('script'); script.textContent = 'window.ran = 1';
        document.body.append(script);
        document.body.insertAdjacentHTML('beforeend', '<img src="data:," onerror="window.ran = 2"><base href="http://x/">');
        document.body.insertAdjacentHTML('beforeend', '<p id="p" style="color: rgb(1, 2, 3)">x</p>'); }"""
    )
    page.wait_for_timeout(200)
    assert page.evaluate("window.ran") is None
    assert page.evaluate("getComputedStyle(document.getElementById('p')).color") != "rgb(1, 2, 3)"
    assert page.evaluate("document.baseURI").startswith("file:")
    page.close()


def turn(page: Any) -> int:
    """The turn that is shown."""
    # It is drawn in the next frame, however long that takes: whoever comes after that one sees it. Both are read in one
    # go: while the page plays, they would be of different frames.
    now, scrub = page.evaluate(
        """() => new Promise(then => requestAnimationFrame(() => requestAnimationFrame(() =>
        then([document.querySelector('#now').innerText, document.querySelector('#scrub').value]))))"""
    )
    found = re.match(r"turn (\d+)/", now)
    assert scrub == found[1]
    return int(found[1])


def test_scrubbing_shows_other_turns(page: Any, episode: Path) -> None:
    turns, opened = read_record(episode).turns, turn_of(episode, "ext_0")
    assert turn(page) == opened
    before = page.inner_html("#benches")
    page.fill("#scrub", "10")
    assert turn(page) == 10
    assert f"tick {turns[10]['tick']}/" in page.inner_text("#now")
    assert page.inner_html("#benches") != before
    page.fill("#scrub", str(opened))
    turn(page)
    assert page.inner_html("#benches") == before
    # A click on the timeline, and on a decision.
    box = page.locator("#timeline").bounding_box()
    page.mouse.click(box["x"] + box["width"] - 13, box["y"] + 40)
    assert turn(page) == len(turns)
    page.click("#decisions button >> nth=0")
    assert turn(page) == 1
    assert "start rxn_0 on slot 0" in page.inner_text("#now")
    assert page.get_attribute("#decisions button >> nth=0", "aria-current") == "true"


def test_the_switch_hides_what_agents_do_not_see(page: Any) -> None:
    """At the extraction bench, whose agent sees pictures and no composition."""
    shown = page.inner_text("#composition")
    assert "dodecane" in shown
    assert re.search(r"\d\.\d{3} mol", shown)
    colors = page.locator("#benches svg rect").count()
    page.click("text=Agent's view")
    hidden = page.inner_text("#composition")
    assert "not observed by ext_0" in hidden
    assert " mol" not in hidden
    assert page.locator("#spectrum svg").count() == 3
    assert page.locator("#benches svg rect").count() > colors + 250
    assert not re.search(r"\d L", page.inner_text("#benches"))
    page.click("text=True contents")
    assert page.inner_text("#composition") == shown
    at = turn(page)
    page.keyboard.press("ArrowRight")
    assert turn(page) == at + 1, "the keys are the page's after the mouse"


def test_what_was_measured_is_what_the_manager_sees(page: Any, episode: Path) -> None:
    turns = read_record(episode).turns
    number = next(i for i, t in enumerate(turns) if t.get("reading", {}).get("instrument") == "gas_chromatograph")
    reading = turns[number]["reading"]
    page.fill("#scrub", str(number + 1))
    page.click("text=Agent's view")
    shown = page.inner_text("#composition")
    assert "just now" in shown
    assert f"{100 * max(reading['values']):.1f} %" in shown
    page.select_option("#look", "slot_7")
    assert "not measured" in page.inner_text("#composition")


def test_the_true_spectrum_is_the_simulators(page: Any, episode: Path) -> None:
    """At the reaction bench the page's spectrum is drawn from amounts; the agent sees the simulator's: the same."""
    page.fill("#scrub", str(turn_of(episode, "rxn_0")))
    turn(page)
    path = "document.querySelector('#spectrum path').getAttribute('d')"
    number = r"(\d+\.\d) (\d+\.\d)"
    true = [float(y) for _, y in re.findall(number, page.evaluate(path))]
    page.keyboard.press("t")
    seen = [float(y) for _, y in re.findall(number, page.evaluate(path))]
    assert len(true) == len(seen) == 200
    assert max(true) - min(true) > 20
    assert true == pytest.approx(seen, abs=0.4)


def test_it_can_be_worked_with_the_keyboard(page: Any, episode: Path) -> None:
    last, opened = len(read_record(episode).turns), turn_of(episode, "ext_0")
    for key, expected in (
        ("ArrowRight", opened + 1),
        ("ArrowLeft", opened),
        ("Home", 0),
        ("ArrowLeft", 0),
        ("PageDown", 1),
        ("PageDown", 2),
        ("End", last),
        ("ArrowRight", last),
        ("PageUp", last - 1),
    ):
        page.keyboard.press(key)
        assert turn(page) == expected
    page.keyboard.press("Home")
    page.select_option("#speed", "40")
    page.locator("#speed").blur()
    page.keyboard.press("Space")
    assert page.inner_text("#play") == "Pause"
    assert any(turn(page) > 3 for _ in range(200)), "it plays"
    page.keyboard.press("Space")
    assert page.inner_text("#play") == "Play"
    stopped = turn(page)
    page.wait_for_timeout(150)
    assert turn(page) == stopped
    page.keyboard.press("t")
    assert page.is_checked("input[value=seen]")
    # Tab reaches everything in order, and shows where it is.
    page.evaluate("document.activeElement.blur()")
    order = []
    for _ in range(9):
        page.keyboard.press("Tab")
        order.append(page.evaluate("document.activeElement.id || document.activeElement.value"))
        assert page.evaluate(
            """() => { const e = document.activeElement, shown = x => getComputedStyle(x).outlineStyle !== 'none';
            return shown(e) || shown(e.closest('label') ?? e); }"""
        )
    assert order[:8] == ["scrub", "first", "back", "play", "forward", "last", "speed", "seen"]
    # On a button space is the button's own, once.
    page.focus("#forward")
    before = turn(page)
    page.keyboard.press("Space")
    assert turn(page) == before + 1
    assert page.inner_text("#play") == "Play"


@pytest.mark.parametrize(("width", "height"), [(320, 640), (768, 1024), (1280, 800)])
def test_it_fits_windows(page: Any, width: int, height: int, episode: Path) -> None:
    """No sideways scrolling, nothing cut off, whatever is shown."""
    page.set_viewport_size({"width": width, "height": height})
    assert page.evaluate("$('rewards').clientWidth") < 420, "charts have texts of the usual size"
    for number in (0, *(turn_of(episode, agent) for agent in ("rxn_0", "ext_0", "dit_0"))):
        page.fill("#scrub", str(number))
        turn(page)
        for _ in range(2):
            page.keyboard.press("t")
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            cut = page.evaluate(
                """() => [...document.querySelectorAll('main *')].filter(e => e.namespaceURI.endsWith('xhtml') &&
                e.getClientRects().length && e.tagName !== 'LEGEND' && e.getBoundingClientRect().right > innerWidth + 1)
                .map(e => e.outerHTML.slice(0, 80))"""
            )
            assert cut == []


def test_signs_and_names_are_whole(page: Any) -> None:
    """The minus sign of a long number at an axis is inside the chart, and a bench's name is on one line."""
    cut = page.evaluate(
        """() => { const { svg } = plot($("spectrum"), [], { x: [0, 1], y: [-0.015, 0], yTicks: [-0.015, 0],
        yText: value => fixed(value, 3), xTicks: [], label: "" });
        return svg.getBoundingClientRect().left - svg.querySelector("text").getBoundingClientRect().left; }"""
    )
    assert cut <= 0.0
    numbers = page.evaluate("[3e-4, -3e-4, 6e-4, -6e-4].map(x => signed(x)).concat(data.cost_items[4])")
    assert numbers == ["0.000", "0.000", "+0.001", "\u22120.001", "invalid actions"], "zero has no sign"
    assert "ext_0" in page.inner_text("#look option >> nth=0")
    lines = page.evaluate(
        """() => [...document.querySelectorAll(".bench > button")].map(button => { button.lastChild.textContent =
        "4-ethyl-5-methylnonane, 14/20"; return button.querySelector("b").getBoundingClientRect().height; })"""
    )
    assert max(lines) < 30
    parts = page.evaluate(
        """() => { $("hidden-card").hidden = false; const table = add($("hidden"), "table");
        for (let i = 0; i < 5; i++) add(add(table, "tr"), "th", {}, "the name of a hidden parameter ".repeat(9));
        return [...table.querySelectorAll("th")].map(row => row.getClientRects().length); }"""
    )
    assert parts == [1] * 5, "no row is divided between columns"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_can_be_read(page: Any, scheme: str) -> None:
    """Contrast of 4.5 to 1 for text and 3 to 1 for lines, on cards, in both colour schemes (WCAG 2.1, AA)."""
    page.emulate_media(color_scheme=scheme)
    names = ["card", "page", "ink", "soft", "warn", "good", "mark", "glass", *(f"a{i}" for i in range(7))]
    values = page.evaluate(
        "names => names.map(n => getComputedStyle(document.documentElement).getPropertyValue('--' + n).trim())", names
    )
    color = dict(zip(names, values, strict=True))
    mixed = page.evaluate(
        """() => data.materials.map(one => { $("past").style.color = lineColor(one.name);
        const parts = getComputedStyle($("past")).color.match(/[\\d.]+/g).slice(-3);
        return "#" + parts.map(x => Math.round(255 * x).toString(16).padStart(2, "0")).join(""); })"""
    )
    color |= {f"material {i}": one for i, one in enumerate(mixed)}
    assert len(set(mixed)) > 10

    def luminance(text: str) -> float:
        parts = [int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    def contrast(one: str, other: str) -> float:
        high, low = sorted((luminance(color[one]), luminance(color[other])), reverse=True)
        return (high + 0.05) / (low + 0.05)

    texts = ["ink", "soft", "good"]
    assert min(contrast(text, ground) for text in texts for ground in ("card", "page")) >= 4.5
    assert contrast("ink", "mark") >= 4.5
    lines = ["warn", "glass", *(f"a{i}" for i in range(7)), *(f"material {i}" for i in range(len(mixed)))]
    assert min(contrast(line, "card") for line in lines) >= 3.0


def test_two_records_have_one_clock(episode: Path, tmp_path: Path, visitor: Any) -> None:
    """A turn chosen in one shows the other at the same tick; the longer one goes on alone."""
    other, both = record_episode(tmp_path / "b.jsonl", policy="random", seed=3), tmp_path / "both.html"
    command("replay", episode, other, "-o", both)
    frames = visitor(both.as_uri()).frames[1:]
    for frame in frames:
        frame.get_by_text("record verified").wait_for()
    for leader, follower in (frames, frames[::-1]):
        for place in ("#first", "#last"):
            leader.locator(place).click()
            tick, late = leader.evaluate("clock()"), time.monotonic() + 60
            while not follower.evaluate(f"turnAt({tick}) === state.turn"):
                assert time.monotonic() < late
        last, turn = follower.evaluate("count"), follower.evaluate("state.turn")
        assert turn == last or follower.evaluate(f"frame({turn} + 1).ticks") > tick
        assert leader.evaluate("state.turn") == leader.evaluate("count")


@pytest.mark.parametrize("suffix", ["gif", "webp"])
def test_a_record_as_an_animation(episode: Path, tmp_path: Path, suffix: str) -> None:
    """It begins and ends with the episode, and has at most as many frames as asked for."""
    picture = read_record(episode)
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(animation(picture, suffix, frames=5, size=(480, 270)))
    with Image.open(path) as made:
        assert (made.size, made.n_frames) == ((480, 270), 5)
        first = np.asarray(made.convert("RGB")).astype(int)
        made.seek(4)
        last = np.asarray(made.convert("RGB")).astype(int)
    replay = Replay(picture)
    begins = draw(laboratory_scene(replay.laboratories), 480, 270)
    for turn in picture.turns:
        replay.play(turn)
    ends = draw(laboratory_scene(replay.laboratories), 480, 270)
    assert np.abs(first - begins).mean() < np.abs(first - ends).mean()
    assert np.abs(last - ends).mean() < np.abs(last - begins).mean()
    picture.turns[2]["play"] = {}
    with pytest.raises(RecordError, match=r"turn 2: play: \w+ had the turn"):
        animation(picture, suffix)


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")
def test_a_record_as_a_video(episode: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its pictures are those of the animation, of which the first and the last are shown longer."""
    path = tmp_path / "a.mp4"
    path.write_bytes(animation(read_record(episode), "mp4", frames=5, size=(480, 270)))
    command = ["ffmpeg", "-loglevel", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    pixels = np.frombuffer(subprocess.run(command, check=True, capture_output=True).stdout, dtype=np.uint8)
    frames = pixels.reshape(-1, 270, 480, 3).astype(int)
    assert len(frames) == 6 + 3 + 16
    begins = draw(laboratory_scene(Replay(read_record(episode)).laboratories), 480, 270)
    assert np.abs(frames[0] - begins).mean() < np.abs(frames[-1] - begins).mean()
    monkeypatch.setenv("PATH", "")
    refused("needs the program ffmpeg", animation, read_record(episode), "mp4", frames=2, size=(480, 270))
