"""The command play."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .common import (
    ScenarioArgument,
    SeedOption,
    SplitOption,
    TrustOption,
    app,
    check_apart_from,
    chosen_agents,
    prepare,
)
from .screen import err, event_words, out, page, plain

if TYPE_CHECKING:
    from ..agents.episodes import PlayedTurn
    from ..agents.policies import Policy
    from ..envs.aec import raw_env
    from ..lab.engine import Laboratories

__all__: list[str] = []


# -- play -------------------------------------------------------------------------------------------------------------


def _background(name: str, labs: Laboratories, people: Sequence[str], seed: int) -> dict[str, tuple[str, Policy]]:
    """(name, policy) of who plays the other roles."""
    from ..agents.policies import agent_policy, make_policies

    pretrained = name == "pretrained"
    made = make_policies("scripted" if pretrained else name, labs, seed)
    chosen = {agent: ("scripted" if pretrained else name, made[agent]) for agent in labs.agents if agent not in people}
    for agent in chosen if pretrained else ():
        learned = "trained" if agent == labs.manager.name else "pretrained"
        try:
            chosen[agent] = (name, agent_policy(learned, labs, labs.agents.index(agent), seed))
        except ValueError as error:
            err.print(f"{agent} is played by the scripted policy: {plain(error)}")
    return chosen


class _Told:
    """Tells people what has come of a turn: of their own all that its agent is told, of others' only that it was."""

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
        notes = ["not possible: the turn is lost"] if turn.info["illegal_action"] else []
        notes += [f"safety: {words}" for words in event_words(named_events(labs.scenario, turn.info))]
        if turn.info["experiment_over"] and turn.agent != labs.manager.name:
            notes.append(self._over(turn.agent))
        for note in notes:
            page.print(f"  [bold]{plain(note)}[/bold]")

    def _over(self, agent: str) -> str:
        labs = self._env.laboratories
        meaning = labs.roles[labs.agents.index(agent)].workplace.score_meaning
        return f"experiment over: {self._env.infos[agent]['score']:+.3f} {meaning}"

    def _decided(self, turn: PlayedTurn) -> None:
        """What a manager's decision means for people at the benches, and what it has read."""
        from ..lab.text import reading_words

        labs = self._env.laboratories
        kind, *arguments = labs.actions.decode(int(turn.action))
        if kind == "recall" and arguments[0] in self._people:
            over = plain(self._over(str(arguments[0])))
            page.print(f"  the manager ends the experiment of {arguments[0]}: {over}")
        if kind == "measure" and turn.agent in self._people:
            page.print(plain(f"  {reading_words(labs, int(arguments[0]), str(arguments[1]))}"))

    def flush(self) -> None:
        """Say who else has acted in the meantime."""
        if self._others:
            counts = ", ".join(f"{agent} {count}x" for agent, count in self._others.items())
            page.print(f"  (meanwhile: {counts})", style="dim")
        self._others = {}


@app.command()
def play(
    scenario: ScenarioArgument,
    role: Annotated[
        list[str] | None,
        typer.Option(help="Whom you play: an agent (rxn_0), a kind (rxn) or all; repeat the option. Default: manager."),
    ] = None,
    background: Annotated[
        str, typer.Option(help="Who plays the others: scripted, scripted:unsafe, random or pretrained.")
    ] = "scripted",
    seed: SeedOption = 0,
    split: SplitOption = "train",
    goal: Annotated[str | None, typer.Option(help="The laboratory's goal. Default: the scenario draws one.")] = None,
    record: Annotated[
        Path | None,
        typer.Option(help="Write the episode's record here; of an episode that you leave early, FILE.part."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a record that is there already.")] = False,
    trust: TrustOption = False,
) -> None:
    """Play one or more roles yourself in the terminal; policies play the others.

    At each of your turns you see what that role's agent sees, no more. Type ? for help and q to leave.
    """
    from ..agents.episodes import play_episode
    from ..agents.human import HumanPolicy, Left
    from ..record import Recorder

    _, env = prepare(scenario, quiet=False, split=split)
    labs = env.laboratories
    if goal is not None:
        labs.goal_index(goal)
    people = chosen_agents(labs.agents, role or ["manager"], "--role")
    others = _background(background, labs, people, seed)
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
    """How people are asked; a prompt may have brackets, which are no markup."""
    with suppress(ImportError):  # where there is one, lines can be edited and called back
        import readline  # noqa: F401
    return lambda prompt: page.input(prompt, markup=False)


def _leave(reason: BaseException, part: Path | None) -> None:
    """End before the episode does."""
    interrupted = isinstance(reason, KeyboardInterrupt)
    kept = f"; the record so far: {part}" if part is not None and part.exists() else ""
    out.print(plain(f"\n{'interrupted' if interrupted else reason}{kept}"))
    raise typer.Exit(130 if interrupted else 0)
