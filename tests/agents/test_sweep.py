"""Sweeps: what is planned, that nothing finished is run again, and that failures are shown and do not stop the rest."""

import contextlib
import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers import children, script, until
from run_files import without_times
from typer.testing import CliRunner

from chemlab.agents.executors import Inline, executor
from chemlab.agents.runs import Run
from chemlab.agents.train.sweep import Status, plan, run_sweep, status_of
from chemlab.cli import app
from chemlab.config.datafile import DataError

SMALL = "[defaults]\nenvs = 2\nrollout = 16\nsteps = 64\nevaluations = 1\neval_episodes = 1\nfinal_episodes = 1\n"
PPO = '[[runs]]\nscenario = "chemlab/FictitiousReaction-v0"\nalgo = "ppo"\n'


def sweep_file(folder: Path, text: str) -> Path:
    file = folder / "sweep.toml"
    file.write_text(SMALL + text)
    return file


def test_order_and_folders(tmp_path: Path) -> None:
    file = sweep_file(
        tmp_path,
        """
        [[runs]]
        scenario = "chemlab/WurtzReaction-v0"
        algo = "ppo"
        seeds = [3]
        [[runs]]
        scenario = ["chemlab/WurtzExtraction-v0", "chemlab/WurtzDistillation-v0"]
        algo = ["ppo", "dqn"]
        seeds = 2
        steps = 1e5
        [[runs]]
        scenario = "chemlab/WurtzExtraction-v0"
        preset = "ppo-xl"
        [[runs]]
        name = "ppo-lab"
        scenario = "salt_from_oil"
        bench = "ext"
        starts = "lab"
        """,
    )
    runs = plan(file, tmp_path / "out")
    cells = [f"Wurtz{b}/{a}" for b in ("Extraction", "Distillation") for a in ("ppo", "dqn")]
    first, second = ([f"{cell}/seed-{seed}" for cell in cells] for seed in (0, 1))
    last = ["WurtzExtraction/ppo-xl/seed-0", "SaltFromOilExtraction/ppo-lab/seed-0"]
    assert [one.name for one in runs] == ["WurtzReaction/ppo/seed-3", *first, *last, *second]
    assert [one.arguments.steps for one in runs[:2]] == [64, 100_000]
    assert runs[-2].arguments.envs == 2, "the file's defaults win over the preset's"
    assert runs[0].run.path == tmp_path / "out" / "WurtzReaction" / "ppo" / "seed-3"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"needs \[\[runs\]\]"),
        ("[[runs]]\nseeds = 0", "seeds: must be the number"),
        ('[[runs]]\nsedes = 3\nalgo = "ppo"', "sedes: unknown argument; did you mean seed"),
        ('[[runs]]\nscenario = "rusch"', "runs 1: .*rusch"),
        ('[[runs]]\nroles = "rxm"', "runs 1: .*rxm"),
        ('[[runs]]\nbench = "rxn"\n[[runs]]\nbench = "rxn"\ngamma = 0.9', "another run above; give this table a name"),
        *(
            (f"[[runs]]\nname = {json.dumps(name)}", "a run's folder cannot be called")
            for name in ("../../x", "/tmp/x", "..", ".", "a/b", "a\\b", "x" * 300)
        ),
    ],
)
def test_wrong_files(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises((ValueError, DataError), match=message):
        plan(sweep_file(tmp_path, text), tmp_path)


ROOT = Path(__file__).parents[2]
SWEEPS = [file for file in (ROOT / "studies").rglob("*.toml") if "[[runs]]" in file.read_text(encoding="utf-8")]


def test_runs_that_the_baselines_and_the_manual_go_on_with_are_runs_of_a_sweep() -> None:
    """And a command that begins from one has networks of its size."""
    trained = {one.name: one.arguments for file in SWEEPS for one in plan(file, Path("results"))}
    pages = [*SWEEPS, *(ROOT / "studies/baselines").glob("*.sh"), *(ROOT / "docs").rglob("*.md")]
    words = "\n".join(page.read_text(encoding="utf-8") for page in pages).replace("seed-$seed", "seed-0")
    run = r"=\s*\"?\$?results/([^/\s\",]+/[\w-]+/seed-\d+)"
    named = set(re.findall(run, words))
    assert len(named) > 15
    assert named <= trained.keys()
    commands = re.findall(r"chemlab train (?:.*\\\n)*.*--begin-from \S*=(?:.*\\\n)*.*", words)
    assert len(commands) > 1
    for command in commands:
        layers = tuple(map(int, re.findall(r"--net-arch (\d+)", command)))
        begun = re.findall(run, re.findall(r"--begin-from (\S+)", command)[0])
        assert {trained[name].net_arch for name in begun} == {layers}, command


def test_of_a_folder_of_all_runs_a_script_takes_those_of_its_sweeps() -> None:
    """All sweeps have the same ``--out`` in the manual. The leaderboard has no benches that learned from nothing."""
    planned = {file.stem: plan(file, Path("results")) for file in SWEEPS}
    for name, sweeps in {"ablations": {"ablations"}, "from_nothing": {"from_nothing", "stages"}}.items():
        is_own = script(f"studies/baselines/{name}.py").is_own
        assert {one.name for runs in planned.values() for one in runs if is_own(one.run)} == {
            one.name for sweep in sweeps for one in planned[sweep]
        }
    has_row = script("docs/baselines.py").has_row
    rows = [one for runs in planned.values() for one in runs if has_row(one.run.path.parent)]
    assert {one.arguments.roles for one in rows if "/benches/" not in one.name} == {("manager",), ("all",)}
    assert {one.name for one in planned["worlds"]} <= {one.name for one in rows}


@pytest.mark.slow
def test_finished_runs_are_left_alone_failures_are_shown_and_the_rest_goes_on(tmp_path: Path) -> None:
    """One run is finished, the next fails, the last failed earlier and is tried again."""
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.train.learn import train

    clone = '[[runs]]\nname = "clone"\nscenario = "chemlab/FictitiousReaction-v0"\nbc = "heuristc"\n'
    file = sweep_file(tmp_path, f"{PPO}{clone}{PPO}seeds = [1]\n")
    out, runner = tmp_path / "out", CliRunner()
    command = ["sweep", str(file), "--processes", "2", "--out", str(out)]
    finished, failing, later = (one.run for one in plan(file, out))
    result = train(plan(file, out)[0].arguments, finished.path)
    times = {path: path.stat().st_mtime_ns for path in finished.path.rglob("*")}
    later.path.mkdir()
    later.failed_file.write_text("{}")
    assert [one.state for one in map(status_of, plan(file, out))] == ["done", "waiting", "failed"]
    first = runner.invoke(app, [*command, "--json"])
    assert first.exit_code == 1
    done, failed, rest = json.loads(first.stdout)
    assert (done["state"], failed["state"], rest["state"]) == ("done", "failed", "done")
    assert done["mean"] == result.mean
    assert {path: path.stat().st_mtime_ns for path in finished.path.rglob("*")} == times
    assert failed["note"].startswith(f"{failing.path / 'log.txt'}: ")
    assert "heuristc" in failed["note"]
    assert failing.config() is None, "the right name in the file is not another run"
    assert later.result() is not None
    shown = runner.invoke(app, [*command, "--status"])
    assert shown.exit_code == 0
    assert "2 done, 1 failed" in shown.output
    # Another task or other arguments in the same folder are neither done nor overwritten.
    config = finished.config()
    finished.config_file.write_text(json.dumps({**config, "fingerprint": "another"}))
    changed = status_of(plan(file, out)[0])
    assert (changed.state, "fingerprint 'another' (now '" in changed.note) == ("other", True)
    finished.config_file.write_text(json.dumps(config))
    file.write_text(file.read_text().replace("steps = 64", "steps = 96"))
    assert status_of(plan(file, out)[0]).state == "other"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes as Linux shows them")
def test_a_run_that_is_killed_and_a_sweep_that_is_stopped_go_on(tmp_path: Path) -> None:
    """At moments nobody chose; the run comes to what one comes to that nobody has disturbed."""
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.train.learn import train

    file = sweep_file(tmp_path, PPO + "steps = 640\ncheckpoints = 20\n")
    (one,), other = plan(file, tmp_path / "out"), Run(tmp_path / "other")
    assert status_of(one).state == "waiting"
    words = ["sweep", str(file), "--out", str(tmp_path / "out")]
    command = [sys.executable, "-m", "chemlab", *words, "--processes", "1"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:

        def reached() -> int:
            """Step of the last checkpoint."""
            assert process.poll() is None, process.communicate()[0]
            last = one.run.checkpoint("last")
            return 0 if last is None else int(last.name.partition("-")[2])

        until(reached)
        assert status_of(one).state == "running"
        (child,) = children(process.pid)
        os.kill(child, signal.SIGTERM)  # as a batch system does it before a node is taken
        until(lambda: child not in children(process.pid))
        lost = reached()
        until(lambda: reached() > lost)
        process.terminate()
        process.communicate()
    assert process.returncode == 130
    stopped = status_of(one)
    assert stopped.state == "interrupted", "its run has been stopped too"
    assert 0 < stopped.step < stopped.steps
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert one.log.read_text().count("resuming at step") == 2
    train(one.arguments, other.path)
    assert without_times(one.run) == without_times(other)


def test_a_run_that_cannot_begin_ends_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("stable_baselines3")

    def refused(words: list[str], log: Path) -> int:
        raise OSError(errno.EDQUOT, "Disk quota exceeded", str(log))

    monkeypatch.setattr("chemlab.agents.train.sweep.run_chemlab", refused)
    runs = plan(sweep_file(tmp_path, f"{PPO}seeds = 2\n"), tmp_path / "out")
    for one, now in zip(runs, run_sweep(runs, Inline(), lambda _: None), strict=True):
        assert (now.state, "Disk quota exceeded" in now.note) == ("failed", True), one.name


def test_waiting_for_another_process_takes_no_processor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("stable_baselines3")
    (one,) = plan(sweep_file(tmp_path, PPO), tmp_path / "out")
    monkeypatch.setattr(one.run, "busy", lambda: True)
    looked: list[float] = []

    def watch(found: list[Status]) -> None:
        looked.append(time.monotonic())
        if len(looked) == 3:
            raise KeyboardInterrupt

    with executor(processes=1, commands=True) as jobs, pytest.raises(KeyboardInterrupt):
        run_sweep([one], jobs, watch, interval=0.1)
    assert looked[-1] - looked[0] >= 0.2


@pytest.mark.slow
def test_a_run_that_another_process_took_first_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.train.learn import train

    (one,) = plan(sweep_file(tmp_path, PPO), tmp_path / "out")
    # It was free when the sweep looked, and taken when its process came.
    busy = one.run.busy
    monkeypatch.setattr(one.run, "busy", lambda: one.log.exists() and busy())
    states: list[str] = []
    with contextlib.ExitStack() as held, executor(processes=1, commands=True) as jobs:
        held.enter_context(one.run.locked())

        def watch(found: list[Status]) -> None:
            states.append(found[0].state)
            if one.run.result() is None and one.log.exists() and "another process is training" in one.log.read_text():
                held.close()
                train(one.arguments, one.run.path)

        ended = run_sweep([one], jobs, watch, interval=0.05)
    assert "failed" not in states
    assert ended[0].state == "done"
    assert not one.run.failed_file.exists()
