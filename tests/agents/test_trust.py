"""Files from strangers run no code: run folders, checkpoints, what their ``config.json`` names, scenarios, the folder
that one works in. Every attack is shown to work where it is trusted, so that a refusal means something."""

import base64
import functools
import json
import os
import pickle
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from helpers import command, limited, refused
from typer.testing import CliRunner

pytest.importorskip("stable_baselines3")

from chemlab.agents import seals
from chemlab.agents.runs import Run
from chemlab.agents.saved import find_saved
from chemlab.agents.seals import read_sealed, seal_file
from chemlab.agents.train.arguments import training_arguments
from chemlab.agents.train.learn import train
from chemlab.cli import app
from chemlab.config.parts import strangers_code

SCENARIO = "wurtz_dodecane"
TINY = {"envs": 2, "rollout": 16, "evaluations": 1, "checkpoints": 1, "eval_episodes": 1, "final_episodes": 1}
MANAGER = training_arguments({"roles": "manager", "algo": "maskable-ppo", "scenario": SCENARIO, "steps": 32, **TINY})
JOINT = training_arguments({"scenario": SCENARIO, "roles": ("dit", "ext"), "steps": 16, **TINY})
LEADER = training_arguments({"roles": "manager", "scenario": SCENARIO, "net_arch": (64, 64), "steps": 16, **TINY})
PARTS = 'from pathlib import Path\nPath({marker!r}).write_text("ran")\n'
FOREIGN = """
base = "wurtz_dodecane"
name = "bait"
title = "Bait"
summary = "A scenario that brings code."
[manager]
reward = ["bait.py:NOTHING"]
"""


class Payload:
    """Leaves a mark where it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.marker),)


def poison_zip(path: Path, marker: Path) -> None:
    """Put a payload into a learner's file, where Stable-Baselines3 has pickles."""
    with zipfile.ZipFile(path) as old:
        contents = {name: old.read(name) for name in old.namelist()}
    data = json.loads(contents["data"])
    data["policy_class"][":serialized:"] = base64.b64encode(pickle.dumps(Payload(marker))).decode()
    with zipfile.ZipFile(path, "w") as new:
        for name, content in (contents | {"data": json.dumps(data).encode()}).items():
            new.writestr(name, content)


def poison(run: Path, marker: Path) -> None:
    """Put a payload into everything in a run's folder that somebody might unpickle."""
    for file in run.rglob("*.zip"):
        poison_zip(file, marker)
    for file in run.rglob("state.pkl"):
        file.write_bytes(pickle.dumps(Payload(marker)))


def without_weights(run: Path) -> None:
    """As an older version left it: pickles alone."""
    for folder in (run / "checkpoints").iterdir():
        for file in [*folder.glob("*.safetensors"), *folder.glob("*.json")] if folder.is_dir() else ():
            file.unlink()


@pytest.fixture(scope="module")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with runs that somebody else has trained: a manager's and a joint one."""
    folder = tmp_path_factory.mktemp("strangers")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CHEMLAB_STATE_DIR", str(folder / "state"))
        train(MANAGER, folder / "manager")
        train(JOINT, folder / "joint")
    return folder


@pytest.fixture
def bait(strangers: Path, tmp_path: Path) -> Path:
    """A copy of those runs, poisoned, beside a scenario with code; ``ran`` is the mark."""
    for name in ("manager", "joint"):
        shutil.copytree(strangers / name, tmp_path / name)
        poison(tmp_path / name, tmp_path / "ran")
    (tmp_path / "bait.toml").write_text(FOREIGN)
    (tmp_path / "bait.py").write_text(PARTS.format(marker=str(tmp_path / "ran")) + "NOTHING = None\n")
    return tmp_path


CONSOLE_SCRIPT = "import sys; sys.path[:] = [p for p in sys.path if p]; from chemlab.cli import main; main()"


def no_end(run: Path) -> Path:
    """A run that has not finished: training it again goes on from its checkpoint."""
    (run / "result.json").unlink()
    return run


PICKLES = {
    "evaluate": lambda at: ["evaluate", SCENARIO, "--policy", at / "manager", "--episodes", 1, "--goal", "dodecane"],
    "evaluate a checkpoint": lambda at: [
        *("evaluate", SCENARIO, "--policy", next((at / "manager").rglob("best-*")) / "model.zip"),
        *("--episodes", 1, "--goal", "dodecane"),
    ],
    "run": lambda at: ["run", SCENARIO, "--policy", at / "manager", "--json"],
    "imitate": lambda at: [
        *("train", "manager", "--algo", "maskable-ppo", "--bc", at / "manager", "--out", at / "new"),
        *("--steps", 32, "--envs", 2, "--rollout", 16, "--bc-steps", 200),
        *("--evaluations", 1, "--eval-episodes", 1, "--final-episodes", 1),
    ],
    "begin": lambda at: [
        *("train", SCENARIO, *LEADER.flags(), "--out", at / "new"),
        *("--begin-from", f"manager={at / 'manager'}"),
    ],
}
"""Commands that play or go on from what the folder of a single agent's run holds."""
WEIGHTS: dict[str, Any] = {
    "export": lambda at: ["export", at / "manager", "--out", at / "mine"],
    "run, joint": lambda at: ["run", SCENARIO, "--policy", at / "joint", "--json"],
    "plan": lambda at: ["audit", "plan", SCENARIO, "--benches", at / "joint", "--budget", 1, "--episodes", 1],
    "begin, joint": lambda at: ["train", SCENARIO, *JOINT.flags(), "--begin-from", at / "joint", "--out", at / "new"],
}
"""The same of weights alone: of roles that have learned together, and of what is exported."""


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize("way", [*PICKLES, *WEIGHTS])
def test_a_strangers_run_is_played_from_its_weights(way: str, bait: Path) -> None:
    command(*(PICKLES | WEIGHTS)[way](bait))
    assert not (bait / "ran").exists()


@pytest.mark.parametrize("way", PICKLES)
def test_a_strangers_pickles_are_refused(way: str, bait: Path) -> None:
    for name in ("manager", "joint"):
        without_weights(bait / name)
    said = command(*PICKLES[way](bait), code=2)
    assert "was changed, or was written by another user" in said
    assert "--trust" in said
    assert not (bait / "ran").exists()
    # It is the refusal that keeps it from running.
    chemlab_trusting(PICKLES[way](bait))
    assert (bait / "ran").exists()


@pytest.mark.parametrize("way", WEIGHTS)
def test_where_only_weights_count_pickles_are_never_loaded(way: str, bait: Path) -> None:
    """Neither the state for resuming nor the learners that older versions wrote, even with the flag."""
    for name in ("manager", "joint"):
        without_weights(bait / name)
    for folder in (bait / "joint" / "checkpoints").glob("*-*"):
        for name in ("dit.zip", "ext.maskable.zip", "state.pkl"):
            (folder / name).write_bytes(pickle.dumps(Payload(bait / "ran")))
    assert "train it again" in command(*WEIGHTS[way](bait), code=2)
    chemlab_trusting(WEIGHTS[way](bait))
    assert not (bait / "ran").exists()


def chemlab_trusting(words: list[object]) -> None:
    """The same command with the flag; whatever comes of loading a payload."""
    CliRunner().invoke(app, [*map(str, words), "--trust"])


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes and devices of POSIX")
@pytest.mark.parametrize("kind", ["pipe", "device"])
@limited(120)
def test_what_never_ends_is_not_read(kind: str, strangers: Path, tmp_path: Path) -> None:
    """Any file of a run's folder as a pipe that nobody writes to, or as a link to a device without an end."""
    run = strangers / "manager"
    best = next(run.glob("checkpoints/best-*")).relative_to(run)
    (role,) = (path.stem for path in (run / best).glob("*.safetensors"))
    words = {
        "run": ["run", SCENARIO, "--policy", tmp_path / "run", "--json"],
        "evaluate": ["evaluate", SCENARIO, "--policy", tmp_path / "run", "--episodes", 1, "--goal", "dodecane"],
        "export": ["export", tmp_path / "run", "--out", tmp_path / "mine", "--trust"],
    }
    weights = [f"{best}/{role}.json", f"{best}/{role}.safetensors"]
    for file, task, gone in (
        ("config.json", "run", []),
        (weights[0], "run", []),
        (weights[1], "evaluate", []),
        (f"{best}/model.zip", "run", weights),
        (f"{best}/model.zip.seal", "run", weights),
        (f"{best}/model.zip", "export", []),
    ):
        shutil.copytree(run, tmp_path / "run")
        for name in (*gone, file):
            (tmp_path / "run" / name).unlink()
        if kind == "pipe":
            os.mkfifo(tmp_path / "run" / file)
        else:
            (tmp_path / "run" / file).symlink_to("/dev/zero")
        said = command(*words[task], code=2)
        assert ("is not a regular file" in said, Path(file).name in said) == (True, True), (file, said)
        assert not list(tmp_path.glob("mine*"))
        shutil.rmtree(tmp_path / "run")


def test_training_does_not_go_on_from_a_strangers_checkpoint(bait: Path) -> None:
    single = ["train", SCENARIO, *MANAGER.flags(), "--out", no_end(bait / "manager")]
    for words in (single, ["train", SCENARIO, *JOINT.flags(), "--out", no_end(bait / "joint")]):
        assert "--trust" in command(*words, code=2)
        assert not (bait / "ran").exists()
        chemlab_trusting(words)
        assert (bait / "ran").is_dir()
        (bait / "ran").rmdir()


def test_what_a_configuration_names_is_no_way_around(bait: Path, strangers: Path) -> None:
    without_weights(bait / "manager")
    own = bait / "pretty"
    shutil.copytree(strangers / "manager", own)  # weights that play, and a bench's pickle in the background
    config = json.loads((own / "config.json").read_text())
    (bait / "manager" / "config.json").write_text(json.dumps({**config, "bench": "rxn"}))
    (own / "config.json").write_text(json.dumps({**config, "background": str(bait / "manager")}))
    assert "--trust" in command("run", SCENARIO, "--policy", own, "--json", code=2)
    # A background that leads back to itself ends.
    (own / "config.json").write_text(json.dumps({**config, "background": str(own)}))
    assert "in the background" in command("run", SCENARIO, "--policy", own, "--json", code=2)
    # A scenario that brings code.
    brings = {"scenario": str(bait / "bait.toml")}
    bringing = {**config, **brings, "arguments": config["arguments"] | brings}
    (own / "config.json").write_text(json.dumps(bringing))
    assert "--trust" in command("export", own, "--out", bait / "mine", code=2)
    assert not (bait / "ran").exists()
    chemlab_trusting(["export", own, "--out", bait / "mine"])
    assert (bait / "ran").read_text() == "ran"


SCENARIOS = {
    "describe": ["describe", "bait.toml"],
    "run": ["run", "bait.toml", "--json"],
    "play": ["play", "bait.toml"],
    "starts": ["export", "starts", "bait.toml", "--episodes", 1, "--out", "starts.json"],
    "evaluate": ["evaluate", "bait.toml", "--episodes", 1],
    "plan": ["audit", "plan", "bait.toml", "--budget", 1, "--episodes", 1],
    "audit": ["audit", "bait.toml", "--processes", 1],
    "difficulty": ["audit", "difficulty", "bait.toml", "--episodes", 1, "--plans", 0, "--explored", 1],
    "warm": ["warm", "bait.toml"],
    "serve": ["serve", "bait.toml", "--speed", 7],
    "train one": ["train", "bait.toml", "--roles", "manager", "--algo", "maskable-ppo", "--steps", 32, "--out", "new"],
    "train all": ["train", "bait.toml", "--steps", 32, "--out", "new"],
    "sweep": ["sweep", "sweep.toml", "--status"],
}


@pytest.mark.parametrize("way", SCENARIOS)
def test_a_scenarios_code_waits_for_the_flag(way: str, bait: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(bait)
    if way == "sweep":  # its status needs the task of a folder that has a run
        run = '[[runs]]\nroles = "manager"\nalgo = "maskable-ppo"\nscenario = "bait.toml"\n'
        (bait / "sweep.toml").write_text(run)
        folder = bait / "results" / "bait-manager_0" / "maskable-ppo" / "seed-0"
        folder.mkdir(parents=True)
        shutil.copy(bait / "manager" / "config.json", folder)
    assert "--trust" in command(*SCENARIOS[way], code=2)
    assert not (bait / "ran").exists()
    chemlab_trusting(SCENARIOS[way])
    assert (bait / "ran").exists()


@pytest.mark.slow
def test_children_of_a_sweep_import_nothing_from_where_it_is_started(bait: Path) -> None:
    sweep = "[defaults]\n" + "".join(f"{key} = {value}\n" for key, value in TINY.items())
    sweep += '[[runs]]\nscenario = "chemlab/WurtzDistillation-v0"\nalgo = "ppo"\nsteps = 32\n'
    (bait / "sweep.toml").write_text(sweep)
    for module in ("typer", "json", "chemlab", "numpy"):
        (bait / f"{module}.py").write_text(PARTS.format(marker=str(bait / "ran")))
    # Not imported by the parent either, which the console script starts with a safe path.
    words = [sys.executable, "-c", CONSOLE_SCRIPT, "sweep", "sweep.toml", "--out", "results"]
    done = subprocess.run(words, cwd=bait, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (bait / "results/WurtzDistillation/ppo/seed-0/result.json").exists()
    assert not (bait / "ran").exists()
    subprocess.run([sys.executable, "-c", "import json"], cwd=bait, check=True)
    assert (bait / "ran").exists(), "they would be imported by a process that looks there"


@pytest.mark.skipif(os.name != "posix", reason="only there a process is replaced")
def test_a_server_that_starts_anew_imports_nothing_from_where_it_is_started(tmp_path: Path) -> None:
    """It does so to hide its salt; agents may write to the folder where it is started."""
    (tmp_path / "typer.py").write_text(PARTS.format(marker=str(tmp_path / "ran")))
    words = [sys.executable, "-c", CONSOLE_SCRIPT, "mcp", "no-scenario"]
    environment = {**os.environ, "CHEMLAB_SALT": "0" * 32}
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert "error: " in done.stderr, done.stdout + done.stderr
    assert not (tmp_path / "ran").exists()


def test_seals_are_of_content_and_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "state.pkl"
    file.write_bytes(b"mine")
    refused("has no signature of this user", read_sealed, file)
    seal_file(file)
    assert read_sealed(file) == b"mine"
    assert read_sealed(shutil.copy(file, tmp_path / "moved") and shutil.copytree(tmp_path, tmp_path / "b") / file.name)
    file.write_bytes(b"mind")
    refused("was changed", read_sealed, file)
    with strangers_code(True):
        assert read_sealed(file) == b"mind"
    file.write_bytes(b"mine")
    monkeypatch.setenv("CHEMLAB_STATE_DIR", str(tmp_path / "other"))
    refused("written by another user", read_sealed, file)
    key = tmp_path / "other" / "seal.key"
    assert len(key.read_bytes()) == 32
    assert os.name != "posix" or key.stat().st_mode & 0o077 == 0, "nobody else reads it"
    (tmp_path / "state.pkl.seal").write_text("é" * 32)
    refused("written by another user", read_sealed, file)


def homeless(path: Path) -> Path:
    if path.parts[0] == "~":
        raise RuntimeError("Could not determine home directory.")
    return path


@pytest.mark.parametrize("place", ["file/state", ""])
def test_without_a_place_for_the_key_a_process_knows_its_own(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its folder cannot be made, or the user has no home folder."""
    for name in ("XDG_STATE_HOME", "LOCALAPPDATA"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv("CHEMLAB_STATE_DIR", place and str(tmp_path / place))
    monkeypatch.setattr(Path, "expanduser", homeless)
    monkeypatch.setattr(seals, "_key", functools.cache(seals._key.__wrapped__))
    (tmp_path / "file").write_bytes(b"mine")
    with pytest.warns(UserWarning, match="set CHEMLAB_STATE_DIR to a writable folder"):
        seal_file(tmp_path / "file")
    assert read_sealed(tmp_path / "file") == b"mine"


def test_own_runs_need_no_flag(tmp_path: Path) -> None:
    train(MANAGER, tmp_path / "manager")
    without_weights(tmp_path / "manager")
    assert list(find_saved(str(tmp_path / "manager")).load) == ["manager"]
    command("run", SCENARIO, "--policy", tmp_path / "manager", "--json")
    assert Run(tmp_path / "manager").result() is not None
