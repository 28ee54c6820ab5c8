"""The command play."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    ScenarioArgument,
    SeedOption,
    SplitOption,
    TrustOption,
    app,
    check_apart_from,
    chosen_agents,
    prepare,
)
from .screen import err, out, page, plain, safety_words

if TYPE_CHECKING:
    from ..agents.episodes import PlayedTurn
    from ..envs.aec import raw_env
    from ..envs.players import Policy
    from ..lab.engine import Laboratories

# -- play -------------------------------------------------------------------------------------------------------------


def _background(name: str, labs: Laboratories, people: Sequence[str]) -> dict[str, tuple[str, Policy]]:
    """Return (name, policy) of the other roles."""
    from ..agents.policies import agent_policy, make_policies

    pretrained = name == "pretrained"
    made = make_policies("scripted" if pretrained else name, labs)
    chosen = {agent: ("scripted" if pretrained else name, made[agent]) for agent in labs.agents if agent not in people}
    for agent in chosen if pretrained else ():
        learned = "trained" if agent == labs.manager.name else "pretrained"
        try:
            chosen[agent] = (name, agent_policy(learned, labs, labs.agents.index(agent)))
        except ValueError as error:
            err.print(f"{agent} is played by the scripted policy: {plain(error)}")
    return chosen


class _Told:
    """Prints the outcome of turns to people: in full for their own agents, only the fact for others."""

    def __init__(self, env: raw_env, people: Sequence[str]) -> None:
        self._env, self._people = env, people
        self._others: dict[str, int] = {}

    def __call__(self, turn: PlayedTurn) -> None:
        from ..lab.text import named_events

        labs = self._env.laboratories
        if turn.agent == labs.manager.name and not turn.info["illegal_action"]:
            self._decided(turn)
        if turn.agent not in self._people:
            self._others[turn.agent] = self._others.get(turn.agent, 0) + 1
            return
        self.flush()
        notes = ["invalid action: it had no effect"] if turn.info["illegal_action"] else []
        # With hidden parameters, exact amounts and scores would be readings free of charge.
        events = safety_words(named_events(labs.scenario, turn.info), amounts=not labs.scenario.hides)
        notes += [f"safety: {words}" for words in events]
        if turn.info["experiment_over"] and turn.agent != labs.manager.name:
            notes.append(self._over(turn.agent))
        for note in notes:
            page.print(f"  [bold]{plain(note)}[/bold]")

    def _over(self, agent: str) -> str:
        labs = self._env.laboratories
        if labs.scenario.hides:
            return "experiment over"
        meaning = labs.roles[labs.agents.index(agent)].workplace.score_meaning
        return f"experiment over: {self._env.infos[agent]['score']:+.3f} {meaning}"

    def _decided(self, turn: PlayedTurn) -> None:
        """Print the consequences of a manager's decision for people at the benches, and its readings."""
        from ..lab.text import reading_words

        labs = self._env.laboratories
        kind, *arguments = labs.actions.decode(int(turn.action))
        if kind == "recall" and arguments[0] in self._people:
            over = plain(self._over(str(arguments[0])))
            page.print(f"  the manager ends the experiment of {arguments[0]}: {over}")
        if kind == "measure" and turn.agent in self._people:
            page.print(plain(f"  {reading_words(labs, int(arguments[0]), str(arguments[1]))}"))

    def flush(self) -> None:
        """Print which other agents have acted in the meantime."""
        if self._others:
            counts = ", ".join(f"{agent} {count}x" for agent, count in self._others.items())
            page.print(f"  (meanwhile: {counts})", style="dim")
        self._others = {}


@app.command()
def play(
    scenario: ScenarioArgument,
    role: Annotated[
        list[str] | None,
        typer.Option(help="Your role: an agent (rxn_0), a kind (rxn) or all; repeatable. Default: manager."),
    ] = None,
    background: Annotated[
        str, typer.Option(help="Policy of the other roles: scripted, scripted:unsafe, random or pretrained.")
    ] = "scripted",
    seed: SeedOption = 0,
    split: SplitOption = "train",
    goal: Annotated[str | None, typer.Option(help="Goal of the laboratory. Default: drawn by the scenario.")] = None,
    record: Annotated[
        Path | None,
        typer.Option(help="Write the episode's record here; for an unfinished episode, FILE.part."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing record.")] = False,
    trust: TrustOption = False,
) -> None:
    """Play one or more roles yourself in the terminal; policies play the others.

    At each of your turns, the observation of that role's agent is shown, and nothing else. Type ? for help and q to
    leave.
    """
    from ..agents.episodes import play_episode
    from ..agents.human import HumanPolicy, Left
    from ..record import Recorder

    _, env = prepare(scenario, quiet=False, split=split)
    labs = env.laboratories
    if goal is not None:
        labs.goal_index(goal)
    people = chosen_agents(labs.agents, role or ["manager"], "--role")
    others = _background(background, labs, people)
    policies: dict[str, Policy] = {agent: policy for agent, (_, policy) in others.items()}
    names = {agent: "human" if agent in people else others[agent][0] for agent in labs.agents}
    recorder = None if record is None else Recorder(record, labs, policies=names, force=force)
    if record is not None:
        check_apart_from(record, scenario, background)
    told = _Told(env, people)
    for agent in people:
        policies[agent] = HumanPolicy(labs, labs.agents.index(agent), _ask(), page, told.flush)
    page.print(f"You play {', '.join(people)}. Type ? for help, q to leave.")
    left = None
    options = None if goal is None else {"goal": goal}
    with recorder or nullcontext():
        try:
            result = play_episode(env, policies, seed, "human", told, options, recorder)
        except (Left, KeyboardInterrupt) as error:
            left = error
    if left is not None:
        _leave(left, recorder.part if recorder is not None else None)
    told.flush()
    page.print(plain(f"\nThe episode is over: {result.words()}"))
    if recorder is not None:
        out.print(f"record: {plain(recorder.path)}")


def _ask() -> Callable[[str], str]:
    """Return the prompt function; prompts may contain brackets without markup."""
    with suppress(ImportError):  # if available, lines can be edited and recalled
        import readline  # noqa: F401
    return lambda prompt: page.input(prompt, markup=False)


def _leave(reason: BaseException, part: Path | None) -> None:
    """Leave before the end of the episode."""
    interrupted = isinstance(reason, KeyboardInterrupt)
    kept = f"; the record so far: {part}" if part is not None and part.exists() else ""
    out.print(plain(f"\n{'interrupted' if interrupted else reason}{kept}"))
    raise typer.Exit(130 if interrupted else 0)
