"""Executors: the same results wherever jobs are played, workers that are lost, and nothing left behind."""

import json
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import job_functions
import pytest
from helpers import running, until
from job_functions import asked, held, killed_at_first, refused, trains_for_long, waits

from chemlab.agents import executors
from chemlab.agents.evaluate.jobs import AUDIT_SEED, AuditBudget, Job, JobRunner
from chemlab.agents.evaluate.play import evaluate, find_target
from chemlab.agents.executors import ATTEMPTS, Inline, WorkerLost, Workers, completed, executor
from chemlab.agents.runs import Run
from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.config.parts import strangers_code

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are killed as POSIX does it")


@contextmanager
def nodes(*cpus: int) -> Iterator[Any]:
    """A Ray cluster of so many nodes, each processes of their own."""
    pytest.importorskip("ray")
    from ray import cloudpickle
    from ray.cluster_utils import Cluster

    cloudpickle.register_pickle_by_value(job_functions)  # workers do not find tests
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": cpus[0], "include_dashboard": False})
    try:
        for count in cpus[1:]:
            cluster.add_node(num_cpus=count)
        cluster.wait_for_nodes()
        yield cluster
    finally:
        cluster.shutdown()


@pytest.fixture(scope="module")
def ray_address() -> Iterator[str]:
    with nodes(2) as cluster:
        yield cluster.address


def slurm(folder: Path) -> Executor:
    """Slurm's part is played by submitit's own processes."""
    pytest.importorskip("submitit")
    import cloudpickle

    cloudpickle.register_pickle_by_value(job_functions)
    backend = executors._Slurm("local", folder)
    backend._engine.update_parameters(timeout_min=5)  # submitit takes jobs below ten minutes as timed out at its signal
    return Workers(backend, 2)


@pytest.fixture(params=["processes", *(pytest.param(name, marks=pytest.mark.slow) for name in ("slurm", "ray"))])
def jobs(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Executor]:
    """Each kind of executor, with two jobs at a time."""
    with ExitStack() as left:
        if request.param == "processes":
            yield left.enter_context(executor(processes=2))
        elif request.param == "slurm":
            yield left.enter_context(slurm(tmp_path / "slurm"))
        else:
            yield left.enter_context(executor(request.getfixturevalue("ray_address")))


@pytest.mark.slow
def test_results_are_the_same_wherever_jobs_are_played(jobs: Executor, tmp_path: Path) -> None:
    """An evaluation, and parts of an audit whose files are those of any other."""
    target = find_target("unlabelled")
    spec, budget = load_scenario("unlabelled"), AuditBudget(4, 40, 10, 2, 6)
    parts = [Job("random", "play", {"policy": "random", "split": "test", "seed": AUDIT_SEED})]
    parts += [Job("foresee-0", "foresee", {"first": 0, "plans": []})]
    known = JobRunner(spec, budget, tmp_path / "here").run(parts)
    assert JobRunner(spec, budget, tmp_path / "there", jobs).run(parts) == known
    for job in parts:
        assert (tmp_path / f"here/{job.name}.json").read_bytes() == (tmp_path / f"there/{job.name}.json").read_bytes()
    here = json.dumps(evaluate(target, [], 3, seed=5))
    assert json.dumps(evaluate(target, [], 3, seed=5, executor=jobs)) == here


def test_batches_are_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any executor will do, and what it plays are the batches that are played without one."""
    monkeypatch.setattr("chemlab.agents.evaluate.play.BATCH", 2)
    target, seen = find_target("chemlab/WurtzDistillation-v0"), []

    class Counting(Inline):
        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Any:
            seen.append(args)
            return super().submit(fn, *args, **kwargs)

    found = evaluate(target, ["random"], 5, goals=["dodecane"], executor=Counting())
    assert found == evaluate(target, ["random"], 5, goals=["dodecane"])
    assert [first for ((_, _, first),) in seen] == [0, 2, 4] * 2
    assert found["policies"][0]["returns"]["dodecane"] == [
        round(float(value), 6) for value in target.play("scripted", "dodecane", 5, 0).returns
    ]


def test_a_killed_worker_s_jobs_are_played_again_and_at_last_given_up(jobs: Executor, tmp_path: Path) -> None:
    futures = [jobs.submit(killed_at_first, number, tmp_path, ATTEMPTS - 1) for number in range(3)]
    assert [future.result() for future in futures] == [0, 1, 4]
    begun = [len(list(tmp_path.glob(f"begun-{number}-*"))) for number in range(3)]
    assert begun[2] == ATTEMPTS
    assert all(1 <= count <= ATTEMPTS for count in begun)
    if isinstance(jobs, Workers) and isinstance(jobs._backend, executors._Slurm):
        return  # where every attempt takes seconds; the rest is not the place's
    with pytest.raises(WorkerLost, match=f"lost {ATTEMPTS} times"):
        jobs.submit(killed_at_first, 2, tmp_path, 100).result()
    assert len(list(tmp_path.glob("begun-2-*"))) == 2 * ATTEMPTS
    assert jobs.submit(killed_at_first, 3, tmp_path, 0).result() == 9, "others have workers again"


@pytest.mark.slow
def test_a_node_that_is_killed_takes_no_result_along(tmp_path: Path) -> None:
    """Two nodes with a job each; one is killed, and its job is played on the other."""
    with nodes(1, 1) as cluster, executor(cluster.address) as jobs:
        futures = [jobs.submit(held, number, tmp_path) for number in range(2)]
        until(lambda: len(list(tmp_path.glob("begun-*"))) == 2)
        lost = cluster.list_all_nodes()[1]
        (mine,) = (path.name.split("-")[1] for path in tmp_path.glob(f"begun-*-{lost.node_id}"))
        cluster.remove_node(lost, allow_graceful=False)
        (tmp_path / f"go-{1 - int(mine)}").touch()  # the other node has room again
        until(lambda: len(list(tmp_path.glob(f"begun-{mine}-*"))) == 2)
        (tmp_path / f"go-{mine}").touch()
        assert [future.result() for future in futures] == [0, 1]


def test_errors_are_those_of_the_job_and_workers_trust_what_is_trusted_here(jobs: Executor) -> None:
    for place in (jobs, Inline()):
        with pytest.raises(DataError, match=r"^file: key: a reason$") as caught:
            list(completed(place, refused, [0]))
        assert "in refused" in str(caught.value.__cause__) or place is not jobs
        assert place.submit(asked).result() == (False, True)
        for told in (False, True):
            with strangers_code(told):
                assert place.submit(asked).result() == (told, told)


def interrupted(job: Callable[[Path], Any], folder: Path, meanwhile: Callable[[], Any]) -> None:
    """Begin a job, and be interrupted when something has happened."""
    with executor(processes=2) as jobs:
        jobs.submit(job, folder)
        until(meanwhile)
        raise KeyboardInterrupt


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes as Linux shows them")
def test_ctrl_c_ends_the_jobs_that_run(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupted(waits, tmp_path, lambda: list(tmp_path.iterdir()))
    (worker,) = (int(path.name) for path in tmp_path.iterdir())
    until(lambda: not running(worker))


def test_ctrl_c_ends_the_commands_that_jobs_have_started(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    run = Run(tmp_path / "run")
    with pytest.raises(KeyboardInterrupt):
        interrupted(trains_for_long, tmp_path, run.curve_file.exists)
    until(lambda: not run.busy())
    assert run.result() is None


def test_a_place_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("submitit")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ValueError, match="no Slurm found"), executor("slurm"):
        pass
    pytest.importorskip("ray")
    for address in ("127.0.0.1:9", "localhost"):
        with pytest.raises(ValueError, match=rf"no Ray cluster to join at '{address}' .*HOST:PORT"), executor(address):
            pass
