"""Commands about laboratories: list, run, compare, starts."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..files import replace_between
from ..scenario import Scenario, load_scenario, scenario_names
from .common import (
    EpisodesOption,
    JsonOption,
    PolicyOption,
    ScenarioArgument,
    SeedOption,
    app,
    err,
    out,
    prepare,
    readable_errors,
)

if TYPE_CHECKING:
    from ..agents.episodes import EpisodeResult, Turn
    from ..laboratory.aec import raw_env
    from ..record import Recorder

__all__: list[str] = []


@app.command("list")
def list_scenarios(as_json: JsonOption = False) -> None:
    """List the scenarios that come with chemlab."""
    scenarios = [load_scenario(name) for name in scenario_names()]
    if as_json:
        rows = [
            {
                "name": s.name,
                "title": s.title,
                "summary": s.summary,
                "agents": ["manager_0", *s.bench_agents()],
                "goals": list(s.lab_goals),
                "file": s.origin,
            }
            for s in scenarios
        ]
        typer.echo(json.dumps(rows, indent=2))
        return
    table = Table(title="Scenarios (play one with: chemlab run NAME)", box=SIMPLE)
    table.add_column("name", no_wrap=True)
    table.add_column("benches", no_wrap=True)
    table.add_column("goals", justify="right")
    table.add_column("summary")
    for s in scenarios:
        table.add_row(s.name, " ".join(s.benches), str(len(s.lab_goals)), s.summary)
    Console().print(table)


def _play(
    env: raw_env,
    policy: str,
    seeds: Iterable[int],
    watch: Any = None,
    recorders: Mapping[int, Recorder] | None = None,
) -> Iterator[EpisodeResult]:
    from ..agents.episodes import play_episode
    from ..agents.policies import make_policies

    for seed in seeds:
        policies = make_policies(policy, env.laboratories, seed)
        with (recorders or {}).get(seed) or nullcontext() as recorder:
            yield play_episode(env, policies, seed, policy, watch, recorder=recorder)


def _recorders(env: raw_env, policy: str, seeds: range, record: Path | None, force: bool) -> dict[int, Recorder]:
    """A recorder for every seed's episode, by seed; a file that is in the way is found before anything is played."""
    from ..record import Recorder

    if record is None:
        return {}
    names = dict.fromkeys(env.possible_agents, policy)
    paths = {s: record if len(seeds) == 1 else record.with_name(f"{record.stem}-{s}{record.suffix}") for s in seeds}
    return {s: Recorder(path, env.laboratories, policies=names, force=force) for s, path in paths.items()}


@app.command()
def run(
    scenario: ScenarioArgument,
    policy: PolicyOption = "heuristic",
    episodes: EpisodesOption = 1,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    record: Annotated[
        Path | None,
        typer.Option(
            help="Write the episode's record here (see `chemlab verify` and `chemlab replay`); of several episodes, "
            "NAME-SEED.EXT each. An episode that is broken off stays as FILE.part."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace records that are there already.")] = False,
) -> None:
    """Play episodes: a live account of what each agent does and what comes of it, then the results."""
    with readable_errors():
        _, env = prepare(scenario, quiet=as_json)
        seeds = range(seed, seed + episodes)
        recorders = _recorders(env, policy, seeds, record, force)
        if as_json:
            for result in _play(env, policy, seeds, recorders=recorders):
                typer.echo(json.dumps(result.as_dict()))
            return
        account = _Account(env)
        results = []
        for number, result in enumerate(_play(env, policy, seeds, account, recorders), start=1):
            results.append(result)
            account.close(result, number, episodes)
        out.print(_result_table(results))
        for recorder in recorders.values():
            out.print(f"record: {escape(str(recorder.path))}")


class _Account:
    """Tells an episode turn by turn: manager decisions and outcomes in full, equal bench actions folded."""

    def __init__(self, env: raw_env) -> None:
        self._env = env
        self._last: tuple[str, str] | None = None
        self._times = 0
        self._since = 0

    def __call__(self, turn: Turn) -> None:
        from ..laboratory.text import action_words

        labs = self._env.laboratories
        words = action_words(labs, labs.agents.index(turn.agent), turn.action)
        if (turn.agent, words) == self._last:
            self._times += 1
        else:
            self._flush()
            self._last, self._times, self._since = (turn.agent, words), 1, turn.tick
        notes = []
        if turn.info.get("illegal_action"):
            notes.append("[yellow]not possible now: the turn is lost[/yellow]")
        notes += [f"[red]safety: {kind} {amount:.3g}[/red]" for kind, amount in turn.info.get("events", {}).items()]
        score = turn.info.get("score") if turn.agent != "manager_0" else None
        outcome = self._outcome(turn, score)
        if notes or outcome:
            self._flush("; ".join([*notes, *([outcome] if outcome else [])]))

    def _outcome(self, turn: Turn, score: float | None) -> str:
        from ..laboratory.text import reading_words

        labs = self._env.laboratories
        if score is not None:
            bench = labs.benches[labs.bench_agents.index(turn.agent)]
            return f"[green]experiment over: {score:+.3f} {bench.score_meaning}[/green]"
        if turn.agent != "manager_0":
            return ""
        kind, *arguments = labs.actions.decode(int(turn.action))
        if kind == "start":
            labs = self._env.laboratories
            station = labs.bench_agents.index(str(arguments[0]))
            vessel = labs.shelf.vessel(0, int(labs.rules.first[station]))
            return f"a vessel with {vessel.volume_l:.2f} L in it; reward: {labs.benches[station].score_meaning}"
        if kind == "measure":
            return reading_words(labs, int(arguments[0]), str(arguments[1]))
        return ""

    def _flush(self, note: str = "") -> None:
        if self._last is None:
            return
        agent, words = self._last
        times = f" x{self._times}" if self._times > 1 else ""
        manager = agent == "manager_0"
        what = f"[bold]{words}[/bold]" if manager else words
        out.print(
            f"tick {self._since:>3}  {'' if manager else '  '}{agent:<10} {what}{times}{'  -> ' + note if note else ''}"
        )
        self._last, self._times = None, 0

    def close(self, result: EpisodeResult, number: int, episodes: int) -> None:
        """The episode's end, in words."""
        self._flush()
        outcome, _, score = result.words().rpartition("; ")
        out.print(f"episode {number}/{episodes} (seed {result.seed}): {outcome}; [bold]{score}[/bold]\n")


def _result_table(results: list[EpisodeResult]) -> Table:
    table = Table(title="Results (mol of the goal submitted; actions of the manager)", box=SIMPLE)
    for name in ("seed", "goal", "mol", "purity", "costs", "score", "actions", "ticks", "safety events"):
        table.add_column(name, justify="left" if name in ("goal", "safety events") else "right", overflow="fold")
    for r in results:
        events = ", ".join(f"{kind} {value:.3g}" for kind, value in r.safety_events.items()) or "none"
        numbers = (f"{r.submitted_mol:.3f}", f"{r.purity:.3f}", f"{sum(r.costs.values()):.4f}", f"{r.score:.3f}")
        table.add_row(str(r.seed), r.goal, *numbers, str(r.manager_actions), str(r.ticks), events)
    return table


@app.command()
def compare(
    scenarios: Annotated[
        list[str] | None, typer.Argument(help="Scenarios; default: all that come with chemlab.")
    ] = None,
    policy: Annotated[list[str] | None, typer.Option(help="Policies to compare; repeat the option.")] = None,
    episodes: EpisodesOption = 100,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    update: Annotated[Path | None, typer.Option(help="Replace the results table in this Markdown file.")] = None,
) -> None:
    """Compare policies over many episodes with the same seeds; also regenerates README's table."""
    from rich.progress import Progress

    policies = policy or ["heuristic", "random"]
    rows: list[dict[str, Any]] = []
    with readable_errors(), Progress(console=err, transient=True) as progress:
        names = scenarios or scenario_names()
        task = progress.add_task("episodes", total=len(names) * len(policies) * episodes)
        for name in names:
            spec, env = prepare(name, quiet=True)
            for played in policies:
                results = []
                for result in _play(env, played, range(seed, seed + episodes)):
                    results.append(result)
                    progress.advance(task)
                rows.append(_summary(spec, played, results))
        lines = _markdown(rows)
        if update is not None:
            replace_between(update, "results", lines)
    typer.echo(json.dumps(rows) if as_json else "\n".join(lines))


def _summary(spec: Scenario, policy: str, results: list[EpisodeResult]) -> dict[str, Any]:
    count = len(results)
    return {
        "scenario": spec.name,
        "policy": policy,
        "episodes": count,
        "submitted_mol": sum(r.submitted_mol for r in results) / count,
        "purity": sum(r.purity for r in results) / count,
        "score": sum(r.score for r in results) / count,
        "manager_actions": sum(r.manager_actions for r in results) / count,
        "ticks": sum(r.ticks for r in results) / count,
        "unsafe_episodes": sum(bool(set(r.safety_events) - {"boiled_dry", "dry_heating"}) for r in results) / count,
    }


def _markdown(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "| scenario | policy | submitted (mol) | purity | score | manager actions | ticks | spill, vent, metal fire |",
        "|---|---|--:|--:|--:|--:|--:|--:|",
    ]
    for r in rows:
        lines.append(
            f"| `{r['scenario']}` | {r['policy']} | {r['submitted_mol']:.3f} | {r['purity']:.3f} | {r['score']:.3f} "
            f"| {r['manager_actions']:.1f} | {r['ticks']:.1f} | {r['unsafe_episodes']:.0%} of episodes |"
        )
    return lines


@app.command()
def starts(
    scenario: ScenarioArgument,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes for each goal.")] = 6,
    seed: SeedOption = 0,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Where to write (default: where it is looked for).")
    ] = None,
) -> None:
    """Record the vessels that reach each bench in laboratory runs, for environments with starts='lab'."""
    from rich.progress import Progress

    with readable_errors(), Progress(console=err, transient=True) as progress:
        spec, _ = prepare(scenario, quiet=True)
        from ..agents.start_recorder import record_starts
        from ..laboratory.starts import starts_file, write_starts

        task = progress.add_task("episodes", total=episodes * len(spec.goals))
        vessels = record_starts(spec, episodes, seed, lambda: progress.advance(task))
        path = out or starts_file(spec)
        write_starts(path, spec, vessels)
    typer.echo(f"{path}: " + ", ".join(f"{len(found)} vessels for {bench}" for bench, found in vessels.items()))
