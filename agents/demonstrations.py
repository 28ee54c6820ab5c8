"""Export of records as demonstrations: one Minari dataset per agent. Needs the extra ``data``.

Minari has no multi-agent datasets. The turns of each agent therefore form single-agent episodes:

| Agent | Episode | Spaces and rewards |
|---|---|---|
| manager | the laboratory's episode | `chemlab/LabManager-v1` |
| bench agent | one experiment, from the manager's `start` to its end | `chemlab/Bench-v1` of that bench |

A reward is the sum of the agent's rewards until its next turn. Rewards while its bench is idle (its share
of the result, if the scenario shares it) belong to its last turn. The rewards of all episodes therefore add
up to the agent's return in the record. An experiment is `terminated` when it ends by the agent, its step limit
or the manager's `recall`, and `truncated` if the laboratory's episode or the record ends first.

Each of the T + 1 observations has the infos `action_mask` (discrete actions), `elapsed_ticks` (since the
agent's previous turn in the episode: the discount of a semi-Markov step) and `cost` (weighted safety events since
then). The last observation of an experiment shows the vessels after the last action. Actions are stored as the
simulator received them, continuous ones as float64, so that replaying them gives the same observations.
"""

from __future__ import annotations

import copy
import os
import shutil
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec

from chemlab import __version__
from chemlab.config.extras import needs
from chemlab.config.loading import plain_scenario
from chemlab.config.scenario import MANAGER_AGENT
from chemlab.lab.engine import Laboratories
from chemlab.record import Record, read_record, recorded_scenario, scenario_hash, verify_record
from chemlab.render.history import Look, Move, RecordReplay
from chemlab.roles.manager_state import RUNNING


@dataclass
class Demonstration:
    """An episode of one agent with T turns.

    Attributes:
        agent: name of the agent.
        goal: goal of the experiment; empty for the manager.
        tick: tick at which the episode began.
        observations, masks, elapsed, costs: T + 1 of each; masks are empty for continuous actions.
        actions, rewards: T of each.
        terminated, truncated: how the episode ended.
    """

    agent: str
    goal: str
    tick: int
    observations: list[npt.NDArray[np.float32]] = field(default_factory=list)
    masks: list[npt.NDArray[np.int8]] = field(default_factory=list)
    elapsed: list[int] = field(default_factory=list)
    costs: list[float] = field(default_factory=list)
    actions: list[Any] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    terminated: bool = False
    truncated: bool = False

    def observe(self, look: Look, elapsed: int, cost: float) -> None:
        """Append an observation with the ticks and costs since the previous one."""
        self.observations.append(look.observation)
        if look.mask is not None:
            self.masks.append(look.mask)
        self.elapsed.append(elapsed)
        self.costs.append(cost)


class _Splitter:
    """Splits one record into the agents' episodes."""

    def __init__(self, record: Record, trust: bool) -> None:
        self._replay = RecordReplay(record, trust)
        self._labs: Laboratories = self._replay.laboratories
        self._open: dict[str, Demonstration] = {}
        self._latest: dict[str, Demonstration] = {}
        self._turn_at: dict[str, int] = {}
        self._pending_cost: dict[str, float] = {}
        self._episodes: dict[str, list[Demonstration]] = {agent: [] for agent in self._labs.agents}

    def episodes(self) -> dict[str, list[Demonstration]]:
        """Return the episodes of every agent in order."""
        for move in self._replay.moves():
            self._add(move)
        state = self._labs.state
        for agent, demonstration in list(self._open.items()):
            self._close(agent, self._replay.look(self._labs.agents.index(agent)))
            over = agent == MANAGER_AGENT and state.status[0] != RUNNING
            demonstration.terminated, demonstration.truncated = over, not over
        return self._episodes

    def _add(self, move: Move) -> None:
        labs = self._labs
        for play in move.plays:
            agent = labs.agents[play.agent]
            if agent not in self._open:
                self._begin(agent, play.agent, move.tick)
            demonstration = self._open[agent]
            elapsed = move.tick - self._turn_at.get(agent, move.tick)
            demonstration.observe(Look(play.observation, play.mask), elapsed, self._pending_cost.pop(agent, 0.0))
            demonstration.actions.append(play.action)
            demonstration.rewards.append(0.0)
            self._turn_at[agent] = move.tick
        for agent, demonstration in self._latest.items():
            # Rewards after the end of an episode belong to it until the agent's next episode begins.
            demonstration.rewards[-1] += move.rewards[agent]
            self._pending_cost[agent] = self._pending_cost.get(agent, 0.0) + move.cost[agent]
        for agent in move.scores:
            if agent in self._open:
                self._open[agent].terminated = True
                self._close(agent, move.last[agent])

    def _begin(self, agent: str, number: int, tick: int) -> None:
        labs = self._labs
        self._open[agent] = self._latest[agent] = Demonstration(agent, labs.roles[number].goal(0), tick)
        self._episodes[agent].append(self._open[agent])
        self._turn_at.pop(agent, None)
        self._pending_cost.pop(agent, None)

    def _close(self, agent: str, look: Look) -> None:
        demonstration = self._open.pop(agent)
        elapsed = int(self._labs.state.ticks[0]) - self._turn_at[agent]
        # The last step of an experiment takes one tick, although the tick has not ended while other benches have their
        # turns.
        elapsed = elapsed if agent == MANAGER_AGENT else max(elapsed, 1)
        demonstration.observe(look, elapsed, self._pending_cost.pop(agent, 0.0))


def demonstrations(record: Record, trust: bool = False) -> dict[str, list[Demonstration]]:
    """Return the episodes of every agent in a record, finished or not.

    Args:
        record: a record; it is not verified here (see :func:`chemlab.record.verify_record`).
        trust: allow imports of code that the record names.

    Raises:
        RecordError: the record cannot be replayed here.
    """
    return _Splitter(record, trust).episodes()


# -- datasets ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Dataset:
    """A written dataset."""

    id: str
    agent: str
    episodes: int
    steps: int
    mean_return: float
    path: str


def _minari() -> Any:
    with needs("demonstrations need Minari", "data"):
        import h5py  # noqa: F401 - needed by Minari's storage, which does not check for it
        import minari
    return minari


def _verified(path: Path, trust: bool, notify: Callable[[str], None]) -> Record:
    """Read and verify a record; report a verdict other than ``ok``.

    Raises:
        RecordError: the file is not a record.
        ValueError: the record is wrong or cannot be verified.
    """
    record = read_record(path)
    verdict = verify_record(record, trust=trust)
    if verdict.status in ("tampered", "unchecked"):
        raise ValueError(f"{path}: {verdict.message}: it cannot serve as a demonstration (see chemlab verify)")
    if verdict.status != "ok":
        notify(f"{path}: {verdict.message}")
    return record


def write_datasets(
    paths: Sequence[Path],
    name: str,
    agents: Sequence[str] | None = None,
    force: bool = False,
    trust: bool = False,
    tell: Callable[[str], None] = lambda note: None,
) -> list[Dataset]:
    """Write a dataset ``NAME/AGENT-v0`` for each agent to Minari's folder (``MINARI_DATASETS_PATH``).

    A dataset's environment has the split of the records if they are all of one, without a private one's salt.

    Args:
        paths: records of one scenario with equal content.
        name: name of the datasets.
        agents: names of agents; default: all agents that had a turn.
        force: replace existing datasets.
        trust: allow imports of code that the records name.
        tell: receives messages for the user.

    Raises:
        ImportError: Minari is not installed; the message names the extra.
        RecordError: a file is not a record, or cannot be replayed here.
        ValueError: a record is wrong, the records are of different scenarios, an agent is unknown or had no turn, or a
            dataset exists already.
    """
    minari = _minari()
    try:
        minari.dataset.minari_dataset.parse_dataset_id(f"{name}/agent-v0")
    except ValueError as error:
        parts = "two or more letters, digits, - and _, in parts separated by /"
        raise ValueError(f"--name: a dataset's name has {parts}; given {name!r:.100}") from error
    for i, path in enumerate(paths):
        if path.resolve() in [earlier.resolve() for earlier in paths[:i]]:
            raise ValueError(f"{path}: is given twice; its episodes would be in the datasets twice")
    records = [_verified(path, trust, tell) for path in paths]
    scenarios = [recorded_scenario(record) for record in records]
    for path, scenario in zip(paths, scenarios, strict=True):
        if scenario_hash(scenario) != scenario_hash(scenarios[0]):
            raise ValueError(f"{path}: has another scenario than {paths[0]}; make a separate dataset of each")
    all_agents: list[str] = records[0].header["agents"]
    unknown = set(agents or ()) - set(all_agents)
    if unknown:
        raise ValueError(f"agent: unknown agent {', '.join(sorted(unknown))}; choose from {', '.join(all_agents)}")
    by_record = [(record, demonstrations(record, trust)) for record in records]
    labs = Laboratories(scenarios[0])
    chosen = []
    for agent in agents or all_agents:
        episodes = [(record, d) for record, found in by_record for d in found[agent]]
        if episodes:
            chosen.append((agent, episodes))
        elif agents:
            raise ValueError(f"agent: {agent} has no turn in these records")
        else:
            tell(f"{agent} has no turn in these records: no dataset")
    if not chosen:
        raise ValueError(f"{', '.join(map(str, paths))}: no agent has a turn; no dataset is written")
    ids = [f"{name}/{agent}-v0" for agent, _ in chosen]
    for id in ids:
        path = minari.storage.get_dataset_path(id)
        if path.exists() and not force:
            raise ValueError(f"dataset {id} already exists ({path}); give another name, or --force to replace it")
    return [_write(minari, id, agent, episodes, labs) for id, (agent, episodes) in zip(ids, chosen, strict=True)]


def _environment(agent: str, labs: Laboratories, split: str | None) -> EnvSpec:
    """Return the spec of a dataset's environment, with a split (None: ``train``)."""
    manager = agent == MANAGER_AGENT
    spec = copy.deepcopy(gymnasium.spec("chemlab/LabManager-v1" if manager else "chemlab/Bench-v1"))
    spec.kwargs["scenario"] = plain_scenario(labs.scenario)
    if split is not None:
        spec.kwargs["split"] = split
    if not manager:
        spec.kwargs["bench"] = labs.roles[labs.agents.index(agent)].key
    return spec


def _write(
    minari: Any, id: str, agent: str, episodes: Sequence[tuple[Record, Demonstration]], labs: Laboratories
) -> Dataset:
    number = labs.agents.index(agent)
    splits = {record.header.get("split") for record, _ in episodes}
    spec = _environment(agent, labs, splits.pop() if len(splits) == 1 else None)
    buffers = [_buffer(minari, record, d) for record, d in episodes]
    players = sorted({str(record.header["policies"].get(agent, "unknown")) for record, _ in episodes})
    path = minari.storage.get_dataset_path(id)
    backup = path.with_name(f".{path.name}.replaced")
    if backup.exists():  # left by an export that was killed
        shutil.rmtree(path, ignore_errors=True)
    elif path.exists():
        path.rename(backup)
    try:
        with warnings.catch_warnings():
            # Minari warns about missing author, email and code permalink, which a record does not contain.
            warnings.filterwarnings("ignore", message=".* is set to None")
            dataset = minari.create_dataset_from_buffers(
                id,
                buffers,
                env=spec,
                observation_space=labs.observation_space(number),
                action_space=labs.action_space(number),
                algorithm_name=", ".join(players),
                description=f"{agent} of chemlab's scenario {labs.scenario.name}, played by {', '.join(players)}",
                requirements=[f"chemlab-marl=={__version__}"],
            )
        dataset.storage.update_episode_metadata(
            [
                {"record": record.path.name, "player": record.header["policies"].get(agent, ""), "tick": d.tick}
                for record, d in episodes
            ]
        )
        dataset.storage.update_metadata({"scenario": labs.scenario.name, "scenario_hash": scenario_hash(labs.scenario)})
    except BaseException:
        shutil.rmtree(path, ignore_errors=True)  # an incomplete dataset would block the next attempt
        if backup.exists():
            backup.rename(path)
        raise
    shutil.rmtree(backup, ignore_errors=True)
    returns = [sum(d.rewards) for _, d in episodes]
    steps = sum(len(d.rewards) for _, d in episodes)
    return Dataset(id, agent, len(episodes), steps, float(np.mean(returns)), os.fspath(path))


def _buffer(minari: Any, record: Record, d: Demonstration) -> Any:
    """Convert an episode to Minari's buffer."""
    ends = np.arange(len(d.rewards)) == len(d.rewards) - 1
    infos = {"elapsed_ticks": np.array(d.elapsed, dtype=np.int64), "cost": np.array(d.costs, dtype=np.float64)}
    if d.masks:
        infos["action_mask"] = np.array(d.masks)
    manager = d.agent == MANAGER_AGENT
    return minari.data_collector.EpisodeBuffer(
        # The laboratory's seed reproduces the manager's episode only; an experiment starts from a vessel of that
        # episode.
        seed=record.header["seed"] if manager else None,
        options=record.header["options"] or None if manager else {"goal": d.goal},
        observations=np.array(d.observations),
        actions=np.array(d.actions),
        rewards=list(d.rewards),
        terminations=list(ends & d.terminated),
        truncations=list(ends & d.truncated),
        infos=infos,
    )
