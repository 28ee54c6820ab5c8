"""Contracts of the recipes for language agents, each with the package that it is for: no model, no accelerator."""

import asyncio
import inspect
from pathlib import Path
from typing import Any

import pytest
from callers import SALT, SEED, played
from helpers import script

from chemlab.agents.ledger import read_ledger
from chemlab.agents.seats import LabTools, Room

HARBOR = Path(__file__).parents[2] / "recipes" / "seats" / "harbor"


def test_trl_finds_tools_reset_and_reward() -> None:
    """As GRPOTrainer looks for them: functions of the class, whose schemas transformers can write."""
    schemas = pytest.importorskip("transformers.utils", reason="needs transformers").get_json_schema
    environment = script("recipes/seats/trl_grpo.py").environment
    made, other = environment(), environment()
    assert type(made) is type(other), "TRL pays an environment only if it has the class of the first"
    names = {name for name, _ in inspect.getmembers(type(made), inspect.isfunction) if not name.startswith("_")}
    assert {"reset", "get_reward", "start", "measure", "look"} <= names
    assert "manager_0 in a simulated" in made.reset(prompt=[])
    assert made.get_reward() == 0.0
    for name in names - {"reset", "get_reward"}:
        function = schemas(getattr(made, name))["function"]
        assert function["name"] == name
        assert all(one["description"] for one in function["parameters"]["properties"].values())
    assert schemas(made.discard)["function"]["parameters"]["properties"]["slot"]["enum"][:3] == [0, 1, 2]


def test_aviary_plays_an_episode(tmp_path: Path) -> None:
    core = pytest.importorskip("aviary.core", reason="needs fhaviary")
    calls, record = played(("manager_0",), tmp_path / "here")
    seat = script("recipes/seats/aviary_env.py").Seat
    env = seat(scenario="unlabelled", folder=tmp_path / "there", salt=SALT, seed=SEED)

    async def play() -> Any:
        messages, tools = await env.reset()
        assert "manager_0 in a simulated" in messages[0].content
        measure = next(tool for tool in tools if tool.info.name == "measure")
        for given in ({"slot": 77, "instrument": "uv_vis"}, None):
            wanted = [("measure", given)] if given else [(verb, given) for _, verb, given in calls]
            for verb, arguments in wanted:
                tool = measure if verb == "measure" else next(one for one in tools if one.info.name == verb)
                action = core.ToolRequestMessage(tool_calls=[core.ToolCall.from_tool(tool, **arguments)])
                answers, reward, done, _ = await env.step(action)
                assert ("slot must be one of 0, 1" in answers[0].content) is bool(given)
        return reward, done

    reward, done = asyncio.run(play())
    assert done
    assert (tmp_path / "there" / "episode-0000.jsonl").read_bytes() == record
    assert reward == read_ledger(tmp_path / "there" / "ledger.jsonl")[-1]["score"]


def test_ivoryos_finds_the_verbs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inspected = pytest.importorskip("ivoryos.parsers.introspection", reason="needs ivoryos")._inspect_class
    monkeypatch.chdir(tmp_path)
    deck = script("recipes/seats/ivoryos_deck.py").laboratory
    assert isinstance(deck, LabTools)
    found = inspected(deck)
    assert {"start", "measure", "submit", "look"} <= set(found)
    assert list(found["measure"]["signature"].parameters) == ["self", "slot", "instrument", "turn"]


def test_harbor_reads_the_task() -> None:
    task = pytest.importorskip("tomllib").loads((HARBOR / "task.toml").read_text())
    (server,) = task["environment"]["mcp_servers"]
    compose = (HARBOR / "environment" / "docker-compose.yaml").read_text()
    assert "chemlab mcp unlabelled --http 8000" in compose
    assert server["url"] == "http://laboratory:8000/manager_0/mcp"
    config = pytest.importorskip("harbor.models.task.config", reason="needs harbor (Python >= 3.12)")
    read = config.TaskConfig.model_validate_toml((HARBOR / "task.toml").read_text())
    assert read.environment.mcp_servers[0].name == "laboratory"


def test_the_verifier_of_harbor_gives_the_score(tmp_path: Path) -> None:
    """Its script on a ledger that a room has written."""
    room = Room("unlabelled", folder=tmp_path)
    room.call("manager_0", "measure", {"slot": 0, "instrument": "uv_vis"})
    room.close()
    program = (HARBOR / "tests" / "test.sh").read_text().split("<<'PY'\n")[1].split("PY\n")[0]
    (tmp_path / "logs").mkdir()
    exec(program.replace("/results", str(tmp_path)).replace("/logs/verifier", str(tmp_path / "logs")), {})
    assert float((tmp_path / "logs" / "reward.txt").read_text()) == room.score < 0.0
