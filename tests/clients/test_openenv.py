"""OpenEnv's client plays a seat of a room over a WebSocket, and its validator accepts the environment's folder."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from callers import SALT, SEED, played, serving

pytest.importorskip("openenv", reason="needs openenv (extra openenv)")
import uvicorn
from openenv.core.generic_client import GenericEnvClient

from chemlab.agents.openenv_server import seat_app


@contextmanager
def served(app: Any) -> Iterator[str]:
    with serving(uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="error"))) as port:
        yield f"http://127.0.0.1:{port}"


def test_an_episode(tmp_path: Path) -> None:
    calls, record = played(("manager_0",), tmp_path / "here")
    app = seat_app(scenario="unlabelled", folder=tmp_path / "there", salt=SALT, seed=SEED)
    with served(app) as url, GenericEnvClient(base_url=url, message_timeout_s=300).sync() as client:
        assert "manager_0 in a simulated" in client.reset(seed=1).observation["result"]
        tools = client.step({"type": "list_tools"}).observation["tools"]
        assert {"start", "measure", "submit", "look", "wait"} <= {tool["name"] for tool in tools}
        wrong = client.step({"type": "call_tool", "tool_name": "measure", "arguments": {"slot": 77}})
        assert wrong.observation["result"].startswith("Error: measure: slot must be one of 0, 1,")
        for _, verb, given in calls:
            last = client.step({"type": "call_tool", "tool_name": verb, "arguments": given})
            assert (last.reward == 0.0) is not last.done
    assert last.done
    assert (tmp_path / "there" / "episode-0000.jsonl").read_bytes() == record


def validated(*arguments: Any) -> str:
    command = [Path(sys.executable).with_name("openenv"), "validate", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_folder_and_server_are_valid() -> None:
    """What needs a container is skipped: nothing fails, and the server passes whole."""
    report = validated(Path(__file__).parents[2] / "recipes" / "openenv", "--skip-build")
    assert "PASS  static.manifest" in report
    assert "FAIL" not in report
    with served(seat_app(scenario="unlabelled")) as url:
        assert "Verdict: PASS" in validated("--url", url, "--timeout", "60")
