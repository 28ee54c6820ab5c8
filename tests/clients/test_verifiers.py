"""verifiers plays seats of a room against a local endpoint that answers with the calls of a scripted episode."""

import asyncio
import hashlib
import json
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from callers import SALT, SEED, Calls

from chemlab.agents.ledger import read_ledger
from chemlab.agents.seats import Room
from studies.tools.seats import play_scripted

pytest.importorskip("verifiers.v1", reason="needs verifiers (extra verifiers)")
import verifiers.v1 as vf
from verifiers.v1.configs.client import EvalClientConfig
from verifiers.v1.harnesses.utils.launch import CHAT_PROGRAM_SOURCE
from verifiers.v1.runtimes.subprocess import SubprocessRuntime
from verifiers.v1.utils.loaders import load_environment

SEATS = ("manager_0", "ext_0")


@contextmanager
def endpoint(calls: Calls) -> Iterator[str]:
    """The address of a model that answers with one call after the other, the first in words only."""
    answers = iter(["I think.", *(f"So: {json.dumps({'verb': verb, 'arguments': given})}" for _, verb, given in calls)])

    class Model(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            asked = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            message = {"role": "assistant", "content": next(answers)}
            usage = {"prompt_tokens": 2, "completion_tokens": 1, "total_tokens": 3}
            whole = {"id": "1", "created": 0, "model": "m", "usage": usage, "object": "chat.completion"}
            choice: dict[str, Any] = {"index": 0, "finish_reason": "stop"}
            if asked.get("stream"):
                chunk = whole | {"object": "chat.completion.chunk", "choices": [choice | {"delta": message}]}
                body, kind = f"data: {json.dumps(chunk)}\n\ndata: [DONE]\n\n".encode(), "text/event-stream"
            else:
                kind = "application/json"
                body = json.dumps(whole | {"choices": [choice | {"message": message}]}).encode()
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *words: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Model)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}/v1"
    server.shutdown()


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The chat program runs in this environment, not in one that is downloaded for it."""
    monkeypatch.setattr(SubprocessRuntime, "scripts_dir", str(tmp_path))
    program = tmp_path / f"{hashlib.sha256(CHAT_PROGRAM_SOURCE.encode()).hexdigest()}.py"
    program.write_text(CHAT_PROGRAM_SOURCE)
    monkeypatch.setitem(SubprocessRuntime._interpreters, str(program), sys.executable)


@pytest.mark.usefixtures("here")
def test_an_episode_of_two_seats(tmp_path: Path) -> None:
    calls = play_scripted(Room("salt_from_oil", SEATS, folder=tmp_path / "here", salt=SALT, seed=SEED))
    assert {agent for agent, *_ in calls} == set(SEATS)
    options = {"salt": SALT, "seed": SEED, "folder": str(tmp_path / "there")}
    taskset = {"id": "chemlab-seats", "scenario": "salt_from_oil", "seats": SEATS, "episodes": 1, "options": options}

    async def play(url: str) -> vf.Episode:
        from chemlab.agents.verifiers_taskset import SeatsConfig

        env = load_environment(SeatsConfig.model_validate({"taskset": taskset}))
        (task,) = list(env.taskset)
        async with env.serving():
            client = EvalClientConfig(base_url=url, api_key_var="NO_KEY")
            return await env.run_episode(task, vf.ModelContext(model="m", client=client))

    with endpoint(calls) as url:
        episode = asyncio.run(play(url))
    assert episode.ok, episode.errors
    record = (tmp_path / "here" / "episode-0000.jsonl").read_bytes()
    assert (tmp_path / "there" / "episode-0000.jsonl").read_bytes() == record
    ended = read_ledger(tmp_path / "there" / "ledger.jsonl")[-1]
    assert [trace.rewards["raw_score"].score for trace in episode.traces] == [ended["score"]] * 2
    assert sum(one["tokens"] for one in ended["seats"].values()) == 3 * (len(calls) + 1)
    assert sum(one["wrong"] for one in ended["seats"].values()) == 1
