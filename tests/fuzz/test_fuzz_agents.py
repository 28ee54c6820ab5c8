"""A few hundred broken files about agents, always the same; more by ``python tests/fuzz/attacks.py agents --look``."""

import json
from pathlib import Path

import fuzz_agents
import numpy as np
import pytest
from fuzz_agents import TRIES, attempt, fuzz
from fuzz_files import toml

pytest.importorskip("stable_baselines3")


def test_what_the_fuzzer_begins_with_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz_agents, "change", lambda content, rng: None)
    monkeypatch.setattr(fuzz_agents, "scribble", lambda text, rng: text.encode("latin-1"))
    monkeypatch.setattr(fuzz_agents, "write_json", lambda path, content, rng: path.write_text(json.dumps(content)))
    monkeypatch.setattr(fuzz_agents, "write_toml", lambda path, content, _, rng: path.write_text(toml(content)))
    for kind in TRIES:
        if kind != "weights":  # in which a header's length is changed, too
            (tmp_path / kind).mkdir()
            assert attempt(tmp_path / kind, kind, np.random.default_rng(4)) == "loaded", kind


@pytest.mark.slow
def test_broken_files_are_readable_errors() -> None:
    outcomes, failures = fuzz(180, seed=0)
    assert not failures, "\n".join(failures)
    # The fuzzer would prove nothing if it broke nothing, or everything.
    assert sum(outcomes.values()) == 180
    assert all(outcomes[f"{kind}: refused"] > 5 for kind in TRIES)
    assert sum(outcomes[f"{kind}: loaded"] for kind in TRIES) > 5
