"""Commands about laboratories: list, describe, run."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import (
    EpisodesOption,
    JsonOption,
    PolicyOption,
    ScenarioArgument,
    SeedOption,
    SplitOption,
    TrustOption,
    app,
    check_apart_from,
    chosen_agents,
    prepare,
)
from .screen import counting, hanging, out, page, plain, safety_words, show_table

if TYPE_CHECKING:
    from ..agents.episodes import EpisodeResult, PlayedTurn
    from ..envs.aec import raw_env
    from ..lab.describe import FactTable
    from ..lab.engine import Laboratories
    from ..record import Recorder


@app.command("list")
def list_scenarios(as_json: JsonOption = False) -> None:
    """List the bundled scenarios, campaigns and syntheses."""
    from ..config.inherit import campaign_names, scenario_names, synthesis_names
    from ..config.loading import load_scenario

    scenarios = [load_scenario(name) for name in scenario_names()]
    campaigns = [load_scenario(name) for name in campaign_names()]
    syntheses = [load_scenario(name) for name in synthesis_names()]
    if as_json:
        rows = [
            {
                "name": s.name,
                "synthesis": s in syntheses,
                "campaign": s in campaigns,
                "title": s.title,
                "summary": s.summary,
                "agents": s.agents(),
                "goals": list(s.lab_goals),
                "file": s.origin,
            }
            for s in (*scenarios, *campaigns, *syntheses)
        ]
        typer.echo(json.dumps(rows, indent=2))
        return
    first = "Scenarios (play one: chemlab run NAME; describe it: chemlab describe NAME)"
    for title, listed in ((first, scenarios), ("Campaigns", campaigns), ("Syntheses", syntheses)):
        cells = [(s.name, ", ".join(s.benches), len(s.lab_goals), s.summary) for s in listed]
        show_table(title, ("name", "benches", "goals", "summary"), cells, right=(2,))


@app.command()
def describe(
    scenario: ScenarioArgument,
    agent: Annotated[
        list[str] | None,
        typer.Option(help="List observations and actions of an agent (rxn_0), a kind (rxn) or all."),
    ] = None,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Describe a scenario: agents, vessels, stock, prices, limits, rewards; with --agent, observations and actions.

    JSON output contains everything about every agent, or about those of --agent.
    """
    from ..lab import describe as facts

    _, env = prepare(scenario, quiet=as_json)
    labs = env.laboratories
    agents = chosen_agents(labs.agents, agent or (), "--agent")
    if as_json:
        typer.echo(json.dumps(facts.description(labs, agents or None), indent=1))
    elif agents:
        for name in agents:
            _show_agent(labs, name)
    else:
        _show_scenario(labs, trust)


def _show(title: str, facts: FactTable) -> None:
    """Print a table of facts."""
    if facts.note:
        title = f"{title}; {facts.note}"
    show_table(title, facts.head, [[cell.replace("`", "") for cell in row] for row in facts.rows], facts.right)


def _show_scenario(labs: Laboratories, trust: bool) -> None:
    """Print everything except the agents' spaces."""
    from ..lab import describe as facts

    spec = labs.scenario
    page.print(f"{plain(spec.title)} ({plain(spec.origin)})", soft_wrap=True)
    page.print(plain(" ".join(facts.goal_words(spec)).replace("`", "")))
    page.print()
    _show(
        f"Agents (observations and actions of one: chemlab describe {spec.argument} --agent NAME"
        f"{' --trust' if trust else ''})",
        facts.agent_table(labs),
    )
    _show("Benches", facts.bench_table(labs))
    if spec.demand.order:
        _show("Orders", facts.order_table(spec))
    if spec.grades:
        _show("Grades, one of which the manager sets for each experiment", facts.grade_table(spec))
    _show(f"Shelf of {spec.shelf.slots} slots, initial state", facts.vessel_table(spec))
    _show("Stock (prices in units of the score: 1 is the theoretical maximum, pure)", facts.stock_table(spec))
    if spec.instruments:
        _show("Instruments", facts.instrument_table(labs))
    if spec.world.draws:
        _show("Hidden parameters, drawn for each episode", facts.world_table(spec))
    benches = [*facts.report_words(spec), *facts.wear_words(spec)]
    for words in (*benches, facts.limit_words(spec), facts.safety_words(spec), facts.reward_words(spec)):
        page.print(plain(words.replace("`", "")))


def _show_agent(labs: Laboratories, agent: str) -> None:
    """Print an agent's observation and actions, number by number."""
    from ..lab import describe as facts

    number = labs.agents.index(agent)
    role, space = labs.roles[number], facts.space_words(labs.action_space(number))
    _show(f"Observation of {agent}: Box({labs.observation_sizes[number]})", facts.channel_table(role.workplace))
    _show(f"Actions of {agent}: {space}", facts.action_list(role.action_meanings, role.action_count > 0))
    if role is not labs.manager:
        page.print(f"Reward at the end of an experiment: {plain(role.workplace.score_meaning)}.")
        page.print(f"An experiment has at most {role.workplace.step_limit} steps.")
    else:
        page.print(f"Paid: {plain(role.workplace.score_meaning)}.")
        page.print(plain(facts.limit_words(labs.scenario).replace("`", "")))
    page.print(plain(facts.reward_words(labs.scenario)))
    page.print()


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
        policies = make_policies(policy, env.laboratories)
        with (recorders or {}).get(seed) or nullcontext() as recorder:
            yield play_episode(env, policies, seed, policy, watch, recorder=recorder)


def _recorders(env: raw_env, policy: str, seeds: range, record: Path | None, force: bool) -> dict[int, Recorder]:
    """Return a recorder per seed; an existing file is reported before anything is played."""
    from ..record import Recorder

    if record is None:
        return {}
    names = dict.fromkeys(env.possible_agents, policy)
    paths = {s: record if len(seeds) == 1 else record.with_name(f"{record.stem}-{s}{record.suffix}") for s in seeds}
    return {s: Recorder(path, env.laboratories, policies=names, force=force) for s, path in paths.items()}


@app.command()
def run(
    scenario: ScenarioArgument,
    policy: PolicyOption = "scripted",
    episodes: EpisodesOption = 1,
    seed: SeedOption = 0,
    split: SplitOption = "train",
    as_json: JsonOption = False,
    record: Annotated[
        Path | None,
        typer.Option(
            help="Write the episode's record here (see `chemlab verify` and `chemlab replay`); for several episodes, "
            "NAME-SEED.EXT each. An interrupted episode stays as FILE.part."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing records.")] = False,
    watch: Annotated[
        bool,
        typer.Option(
            "--watch", help="Show the episodes in a browser instead, as `chemlab serve` does (needs the extra `live`)."
        ),
    ] = False,
    trust: TrustOption = False,
) -> None:
    """Play episodes: print every agent's actions and their outcomes, then the results."""
    if watch:
        from .servers import serve

        if record is not None or as_json or episodes > 1:
            raise ValueError("--watch: cannot be given with --record, --json or --episodes; the page has these")
        serve(scenario, [policy], seed, split)
        return
    _, env = prepare(scenario, quiet=as_json, split=split)
    seeds = range(seed, seed + episodes)
    recorders = _recorders(env, policy, seeds, record, force)
    for recorder in recorders.values():
        check_apart_from(recorder.path, scenario, policy)
    if as_json:
        for result in _play(env, policy, seeds, recorders=recorders):
            typer.echo(json.dumps(vars(result)))
        return
    account = _Account(env)
    results = []
    for number, result in enumerate(_play(env, policy, seeds, account, recorders), start=1):
        results.append(result)
        account.close(result, number, episodes)
    _show_results(results)
    for recorder in recorders.values():
        out.print(f"record: {plain(recorder.path)}")


@app.command()
def warm(
    scenario: Annotated[list[str] | None, typer.Argument(help="Default: all bundled scenarios.")] = None,
    trust: TrustOption = False,
) -> None:
    """Compile the kernels of scenarios ahead, by playing an episode of each; later starts load them from the cache."""
    from ..config.inherit import campaign_names, scenario_names, synthesis_names

    names = scenario or [*scenario_names(), *campaign_names(), *synthesis_names()]
    prepared = [prepare(name, quiet=True) for name in names]
    with counting() as progress:
        task = progress.add_task("scenarios", total=len(names))
        for spec, env in prepared:
            progress.update(task, description=spec.name)
            for _ in _play(env, "scripted", (0,)):
                progress.advance(task)
    out.print(f"{len(names)} scenarios are compiled")


class _Account:
    """Prints an episode turn by turn: manager decisions and outcomes in full, runs of equal bench actions folded."""

    def __init__(self, env: raw_env) -> None:
        self._env = env
        self._last: tuple[str, str] | None = None
        self._times = 0
        self._since = 0

    def __call__(self, turn: PlayedTurn) -> None:
        from ..lab.text import action_words, named_events

        labs = self._env.laboratories
        said = action_words(labs, labs.agents.index(turn.agent), turn.action)
        if (turn.agent, said) == self._last:
            self._times += 1
        else:
            self._flush()
            self._last, self._times, self._since = (turn.agent, said), 1, turn.tick
        notes = []
        if turn.info["illegal_action"]:
            notes.append("[yellow]invalid action: it had no effect[/yellow]")
        events = named_events(labs.scenario, turn.info)
        notes += [f"[red]safety: {plain(words)}[/red]" for words in safety_words(events)]
        score = turn.info["score"] if turn.agent != labs.manager.name and turn.info["experiment_over"] else None
        outcome = self._outcome(turn, score)
        if notes or outcome:
            self._flush("; ".join([*notes, *([outcome] if outcome else [])]))

    def _outcome(self, turn: PlayedTurn, score: float | None) -> str:
        from ..lab.text import reading_words

        labs = self._env.laboratories
        if score is not None:
            meaning = labs.roles[labs.agents.index(turn.agent)].workplace.score_meaning
            return f"[green]experiment over: {score:+.3f} {plain(meaning)}[/green]"
        if turn.agent != labs.manager.name:
            return ""
        kind, *arguments = labs.actions.decode(int(turn.action))
        if kind == "start":
            role = labs.bench_roles[labs.bench_agents.index(str(arguments[0]))]
            vessel = labs.shelf.vessel(0, role.first_position)
            return f"a vessel with {vessel.volume_l:.2f} L in it; reward: {plain(role.workplace.score_meaning)}"
        if kind == "measure":
            return plain(reading_words(labs, int(arguments[0]), str(arguments[1])))
        return ""

    def _flush(self, note: str = "") -> None:
        if self._last is None:
            return
        agent, words = self._last
        times = f" x{self._times}" if self._times > 1 else ""
        manager = agent == self._env.laboratories.manager.name
        what = f"[bold]{plain(words)}[/bold]" if manager else plain(words)
        head = f"tick {self._since:>3}  {'' if manager else '  '}{agent:<10} "
        hanging(head, f"{what}{times}{'  -> ' + note if note else ''}")
        self._last, self._times = None, 0

    def close(self, result: EpisodeResult, number: int, episodes: int) -> None:
        """Print the result of the episode."""
        self._flush()
        outcome, _, score = result.words().rpartition("; ")
        out.print(f"episode {number}/{episodes} (seed {result.seed}): {plain(outcome)}; [bold]{plain(score)}[/bold]\n")


def _show_results(results: list[EpisodeResult]) -> None:
    rows: list[tuple[Any, ...]] = []
    for r in results:
        numbers = (f"{r.submitted_mol:.3f}", f"{r.purity:.3f}", f"{sum(r.costs.values()):.4f}", f"{r.score:.3f}")
        events = ", ".join(safety_words(r.safety_events)) or "none"
        rows.append((r.seed, r.goal, *numbers, r.manager_actions, r.ticks, events))
    if len(results) > 1:
        numbers_of = [(r.submitted_mol, r.purity, sum(r.costs.values()), r.score) for r in results]
        means = [sum(values) / len(results) for values in zip(*numbers_of, strict=True)]
        rows.append(
            ("mean", "", *(f"{m:.{digits}f}" for m, digits in zip(means, (3, 3, 4, 3), strict=True)), "", "", "")
        )
    head = ("seed", "goal", "mol", "purity", "costs", "score", "actions", "ticks", "safety events")
    show_table("Results (mol of the goal submitted; actions of the manager)", head, rows, right=(0, *range(2, 8)))
