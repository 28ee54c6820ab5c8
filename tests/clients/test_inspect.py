"""inspect_ai plays seats of a room with its mock model."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from callers import SALT, SEATS, SEED, Calls, played

from chemlab.agents.ledger import read_ledger

pytest.importorskip("inspect_ai", reason="needs inspect_ai (extra inspect)")
from inspect_ai import eval as evaluate
from inspect_ai.model import ModelOutput, ModelUsage, get_model

from chemlab.agents.inspect_task import laboratory


def outputs(calls: Calls) -> Iterator[ModelOutput]:
    """Words, a refused call, then the calls; each with its usage, as inspect would download a tokenizer otherwise."""
    wrong = ("", "measure", {"slot": 77, "instrument": "uv_vis"})
    made = [ModelOutput.for_tool_call("mockllm/model", verb, given) for _, verb, given in (wrong, *calls)]
    for output in (ModelOutput.from_content("mockllm/model", "I think."), *made):
        output.usage = ModelUsage(input_tokens=2, output_tokens=1, total_tokens=3)
        yield output


@pytest.mark.parametrize("seats", [("manager_0",), SEATS])
def test_an_episode(seats: tuple[str, ...], tmp_path: Path) -> None:
    calls, record = played(seats, tmp_path / "here")
    model = get_model("mockllm/model", custom_outputs=outputs(calls), memoize=False)
    options: dict[str, Any] = {"salt": SALT, "seed": SEED, "folder": str(tmp_path / "there")}
    task = laboratory("unlabelled", list(seats), episodes=1, **options)
    (log,) = evaluate(task, model, log_dir=str(tmp_path / "logs"), display="none")
    assert log.status == "success", log.error
    (sample,) = log.samples
    assert (tmp_path / "there" / "episode-0000.jsonl").read_bytes() == record
    ended = read_ledger(tmp_path / "there" / "ledger.jsonl")[-1]
    assert sample.scores["raw_score"].value == ended["score"]
    counts = ended["seats"].values()
    assert sum(one["tokens"] for one in counts) == 3 * (len(calls) + 2)
    assert 1 <= sum(one["wrong"] for one in counts) <= 2  # inspect itself refuses what its schema excludes


def test_an_episode_that_a_limit_ends_is_scored(tmp_path: Path) -> None:
    calls, _ = played(("manager_0",), tmp_path / "here")
    model = get_model("mockllm/model", custom_outputs=outputs(calls), memoize=False)
    task = laboratory("unlabelled", "manager_0", episodes=1, folder=str(tmp_path / "there"))
    (log,) = evaluate(task, model, log_dir=str(tmp_path / "logs"), display="none", token_limit=10)
    (sample,) = log.samples
    assert sample.limit.type == "token"
    ended = read_ledger(tmp_path / "there" / "ledger.jsonl")[-1]
    assert (ended["status"], ended["score"]) == ("given up", sample.scores["raw_score"].value)


def test_the_command_finds_the_task(tmp_path: Path) -> None:
    """Under the same name in an editable install and in any other: it fails for its scenario, not for its name."""
    command = [Path(sys.executable).with_name("inspect"), "eval", "chemlab/laboratory", "-T", "scenario=nowhere"]
    command += ["-T", "seats=manager_0,dit_0", "-T", "episodes=1", "--model", "mockllm/model", "--display", "plain"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert "nowhere" in done.stdout + done.stderr
    assert "unknown name" in " ".join((done.stdout + done.stderr).split())
