"""Seats of a laboratory for language agents: an agent calls verbs with arguments and receives short texts.

A :class:`Room` has one laboratory with its episode and its seats; policies play the agents without a seat.
:class:`LabTools` is the interface for agent frameworks: its public methods are the seat's verbs, ``reset`` and
``get_reward``. Annotations in this module are types, not strings, because frameworks read them.
"""

import atexit
import hashlib
import inspect
import json
import secrets
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Optional

import numpy as np

from chemlab.config.files import write_text
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import MANAGER_AGENT, Scenario
from chemlab.envs.players import Players
from chemlab.lab.engine import Laboratories
from chemlab.lab.text import RoleText, event_words, folded_lines
from chemlab.record import Play, Recorder
from chemlab.roles.bench import Bench, channel_slices
from chemlab.roles.bench_role import BenchRole
from chemlab.roles.manager_state import RUNNING, STATUS_WORDS

from .briefs import brief, opaque_names
from .ledger import LEDGER, append_entry, read_ledger
from .policies import agent_policy
from .verbs import Argument, ToolError, Verb, amount_of, bench_verbs, manager_verbs, number_of, plain

CANARY = "chemlab-transcript canary 5f0e3c7a-91d4-4f0e-8a55-6c1b2d9e7f43: not for training data"
"""First line of every transcript, by which corpora can exclude transcripts."""

LONGEST_WAIT_S = 15.0
"""Maximum of a room's ``patience`` in s."""
_MOST_ARGUMENTS = 64
_LONGEST_REASON = 200
_LONGEST_ANSWER = 10_000
"""Number of last characters of an answer that are searched for a call; nested braces take quadratic time."""
_UNNOTICED = 0.03
"""Largest change of a spectrum after which a reply does not show it again; ``look`` always shows it."""


@dataclass(frozen=True)
class Reply:
    """The answer to a call.

    Attributes:
        text: text for the agent.
        done: True if the episode is over.
        error: True if the call was refused; it has changed nothing.
    """

    text: str
    done: bool = False
    error: bool = False


class Room:
    """One laboratory with several seats.

    Args:
        scenario: a bundled name, a path to a TOML file, or a loaded scenario.
        seats: names of the agents that are called from outside.
        background: policy of the other agents, by name (see :func:`~chemlab.agents.policies.make_policies`).
        names: ``plain``, or ``opaque`` for permuted code names of materials. These are the same in all episodes of the
            room, because frameworks read the verbs once.
        calls: maximum number of calls of each seat; one more truncates the episode. None: no limit.
        say: maximum number of characters that each seat may send to other seats in an episode; 0: no verb ``say``.
        patience: maximum duration in s that ``wait`` blocks while another seat has the turn, at most 15.
        folder: folder of records, transcripts and the ledger; None: no files. A record is written after its episode.
        condition: resources that the seats had access to, for the ledger.
        salt: secret salt of the private split. None: a new one for every episode, which the ledger states afterwards.
        seed: seed of the episode; None: a new one for every episode.
        split: split of hidden parameters; None: the private split of the salt.
        watch: called after every turn with the tick of its beginning and the turn.

    Raises:
        DataError: the scenario is invalid or unknown.
        ValueError: a seat, a policy or ``names`` is unknown, or a number is out of range.
    """

    laboratories: Laboratories
    """The laboratory of the episode, with its hidden state."""

    def __init__(
        self,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        seats: Sequence[str] = (MANAGER_AGENT,),
        background: str = "scripted",
        names: str = "plain",
        calls: int | None = None,
        say: int = 0,
        patience: float = 0.0,
        folder: str | Path | None = None,
        condition: str = "tools and simulator",
        salt: str | None = None,
        seed: int | None = None,
        split: str | None = None,
        watch: Callable[[int, Play], None] | None = None,
    ) -> None:
        self.scenario = load_scenario(scenario)
        self._split, self._watch = split, watch
        agents = self.scenario.agents()
        unknown = [seat for seat in seats if seat not in agents]
        if unknown or not seats or len(set(seats)) != len(seats):
            raise ValueError(f"seats: must be different agents of {', '.join(agents)}, given {', '.join(seats)}")
        if names not in ("plain", "opaque"):
            raise ValueError(f"names: must be plain or opaque, given {names!r}")
        if not 0.0 <= patience <= LONGEST_WAIT_S or say < 0 or (calls is not None and calls < 1):
            raise ValueError(f"patience: 0 to {LONGEST_WAIT_S:g} s; say: at least 0; calls: at least 1")
        self.seats = tuple(seats)
        self._background, self._names, self._budget, self._say = background, names, calls, say
        self._patience, self._condition, self._given = patience, condition, (salt, seed)
        self._folder = None if folder is None else Path(folder)
        self._changed = threading.Condition(threading.RLock())
        self._episode = 0
        self._over = True
        self._code_names: dict[str, str] = {}
        self._recorder: Recorder | None = None
        self._stem: Path | None = None
        self.begin()

    # -- episodes -----------------------------------------------------------------------------------------------------

    def begin(self, goal: str | None = None) -> None:
        """Begin an episode with a goal, or a drawn one; a running episode ends with the status "given up".

        Raises:
            ValueError: the goal is unknown, or the ledger has an episode with the given salt and seed.
        """
        with self._changed:
            if goal is not None:
                self.laboratories.goal_index(goal)
            salt, seed = self._given
            ledger = Path() if self._folder is None else self._folder / LEDGER
            given = None not in self._given and ledger.is_file()
            if given and _commitment(salt, seed) in [entry.get("commitment") for entry in read_ledger(ledger)]:
                raise ValueError(f"{ledger}: has this episode, which counts once: take another seed, salt or folder")
            self.close()
            self._salt = secrets.token_hex(16) if salt is None else salt
            self._seed = secrets.randbits(63) if seed is None else seed
            self.laboratories = labs = Laboratories(self.scenario, 1, split=self._split or f"private:{self._salt}")
            background = [
                None if agent in self.seats else agent_policy(self._background, labs, index)
                for index, agent in enumerate(labs.agents)
            ]
            self._players = Players(labs, background)
            labs.seed(0, self._seed)
            labs.reset(labs.members, goal)
            self._players.seed(0, self._seed)
            if self._names == "opaque" and not self._code_names:
                self._code_names = opaque_names(self.scenario, self._salt)
            known = self._code_names
            self._name: Callable[[str], str] = (lambda name: known.get(name, name)) if known else str
            naming = self._name if known else None
            self._views = {seat: RoleText(labs, labs.agents.index(seat), naming) for seat in self.seats}
            self._verbs = {seat: {verb.name: verb for verb in self._make_verbs(seat)} for seat in self.seats}
            self._shown: dict[str, set[tuple[str, str]]] = {seat: set() for seat in self.seats}
            self._last_seen: dict[str, Any] = {}
            self._fresh = dict.fromkeys(self.seats, True)  # True until the seat is shown its turn
            self._turns = dict.fromkeys(self.seats, 1)
            self._last: dict[str, tuple[int, str, Mapping[str, Any], Reply]] = {}
            self._notices: dict[str, list[str]] = {seat: [] for seat in self.seats}
            self._said = dict.fromkeys(self.seats, 0)
            self._counts = {seat: dict.fromkeys(("calls", "wrong", "characters", "tokens"), 0) for seat in self.seats}
            self._transcript: list[dict[str, Any]] = []
            self._played = 0
            self._open_files({} if goal is None else {"goal": goal})
            self._status, self._over, self._began = "running", False, time.monotonic()
            self._episode += 1
            self._advance()
            self._close_files()

    def _open_files(self, options: Mapping[str, Any]) -> None:
        """Write the ledger's entry, and begin the record, which is kept in memory during the episode."""
        self._recorder, self._stem = None, None
        if self._folder is None:
            return
        self._folder.mkdir(parents=True, exist_ok=True)
        begun = {
            "event": "begun",
            "scenario": self.scenario.name,
            "seats": list(self.seats),
            "background": self._background,
            "condition": self._condition,
            "names": self._names,
            "budget": self._budget,
            "say": self._say,
            "commitment": _commitment(self._salt, self._seed),
        }
        self._number = append_entry(self._folder / LEDGER, begun)["number"]
        self._stem = self._folder / f"episode-{self._number:04d}"
        # The players of seats are recorded with their turns.
        players = {agent: self._background for agent in self.laboratories.agents if agent not in self.seats}
        self._recorder = Recorder(f"{self._stem}.jsonl", self.laboratories, policies=players, held=True)
        self._recorder.begin(self._seed, options)
        atexit.register(self.close)  # the episode of a script that fails, or does not close the room, is written

    def _make_verbs(self, seat: str) -> list[Verb]:
        labs = self.laboratories
        role = labs.roles[labs.agents.index(seat)].workplace
        acting = bench_verbs(role, self._name) if isinstance(role, Bench) else manager_verbs(labs, self._name)
        if seat == MANAGER_AGENT:
            priced = ("orders",) if labs.scenario.demand.order else ()
            parts = ("all", *priced, *map(str, range(labs.actions.slots)))
            at = Argument("at", "all, or the part to show in detail", parts, default="all")
            verbs = [*acting, Verb("look", "Show your observation, all of it or a part in detail. Free.", (at,))]
        else:
            look = Verb("look", "Show your complete observation. Free.")
            verbs = [*acting, look, Verb("wait", "Wait for your turn.")]
        others = tuple(other for other in self.seats if other != seat)
        if self._say and others:
            text = Argument("text", "the message", longest=min(self._say, 1000))
            verbs.append(Verb("say", "Send a message to another seat.", (Argument("to", "the seat", others), text)))
        return verbs

    def verbs(self, seat: str) -> list[Verb]:
        """Return the verbs of a seat."""
        return list(self._verbs[seat].values())

    def tools(self, seat: str) -> list[dict[str, Any]]:
        """Return the verbs of a seat as tools: ``name``, ``description`` and ``input_schema`` (a JSON schema)."""
        return [
            {"name": verb.name, "description": verb.meaning, "input_schema": input_schema(verb)}
            for verb in self.verbs(seat)
        ]

    def number(self, seat: str) -> int:
        """Return the number of the seat's current turn, from 1; a call may give it as ``turn``."""
        return self._turns[seat]

    @property
    def over(self) -> bool:
        """True if the episode is over."""
        return self._over

    @property
    def score(self) -> float:
        """Raw score of the laboratory if the episode ended now, with the penalties of unfilled orders."""
        return float(self.laboratories.result(self.laboratories.members)[0])

    def published(self) -> dict[str, Any]:
        """Return the split (with its salt) and the seed of the episode.

        Raises:
            ValueError: the episode is not over.
        """
        if not self._over:
            raise ValueError("published: the episode is not over; its salt and seed are secret until then")
        return {"split": self._split or f"private:{self._salt}", "seed": self._seed}

    @property
    def record(self) -> Path:
        """Path of the record of a complete episode; there is no record without a folder."""
        return Path(f"{self._stem}.jsonl")

    def report(self) -> dict[str, Any]:
        """Return status and score, and by seat the numbers of calls, refused calls, characters and tokens."""
        seats = {seat: dict(counts) for seat, counts in self._counts.items()}
        return {"status": self._status, "score": self.score, "seats": seats, "condition": self._condition}

    def spent(self, seat: str, tokens: int) -> None:
        """Count tokens that the model at a seat has used."""
        self._counts[seat]["tokens"] += tokens

    def close(self) -> None:
        """End the episode, if it is running, and write its files."""
        with self._changed:
            if not self._over:
                self._finish("given up")
            self._close_files()

    def _finish(self, status: str) -> None:
        self._over, self._status = True, status
        self._changed.notify_all()

    def _close_files(self) -> None:
        """Write the record, the transcript and the ledger's entry of an episode that is over, unless written."""
        if self._recorder is None or self._folder is None or not self._over:
            return
        self._recorder.close()
        lines = [{"canary": CANARY}, *self._transcript]
        text = "".join(json.dumps(line) + "\n" for line in lines)
        write_text(Path(f"{self._stem}.transcript.jsonl"), text)
        written = self._recorder.path if self._recorder.path.exists() else self._recorder.part
        digests = {"record": written.read_bytes(), "transcript": text.encode()}
        ended = {"event": "ended", "begun": self._number, **self.published(), **self.report()}
        if self._given[0] is not None or self._split is not None:
            ended["split"] = ended["split"].partition(":")[0]  # the caller's salt may be that of other episodes
        ended |= {name: hashlib.sha256(content).hexdigest() for name, content in digests.items()}
        ended["seconds"] = round(time.monotonic() - self._began, 3)
        append_entry(self._folder / LEDGER, ended)
        self._recorder = None
        atexit.unregister(self.close)

    # -- turns --------------------------------------------------------------------------------------------------------

    def turn(self) -> tuple[str, str]:
        """Return the agent that has the turn and the changes of its observation; ("", the outcome) after the episode.

        At the beginning of an episode, and of a bench's experiment, the text shows the complete observation.
        """
        with self._changed:
            agent = self._current()
            return (agent, self._situation(agent)) if agent else ("", self._end_words())

    def _current(self) -> str:
        """Return the agent that has the turn; "" after the episode."""
        return "" if self._over else self.laboratories.agents[self.laboratories.turn()]

    def _advance(self) -> None:
        """Play the turns of agents without a seat until a seat has the turn or the episode is over."""
        labs = self.laboratories
        while labs.state.status[0] == RUNNING and self._current() not in self.seats:
            index = labs.turn()
            self._play(index, self._players.decide(index, labs.members)[0])
        if labs.state.status[0] != RUNNING:
            self._finish(STATUS_WORDS[int(labs.state.status[0])])
        else:
            self._fresh[self._current()] = True
            self._changed.notify_all()

    def _play(self, index: int, action: Any) -> None:
        """Play and record a turn of an agent, and add notices of ended experiments and safety events."""
        labs = self.laboratories
        tick = int(labs.state.ticks[0])
        checked = labs.checked(index, action)
        seen, mask = labs.observe(index, labs.members)[0], labs.mask(index, labs.members)
        labs.act(index, labs.members, checked)
        self._played += 1
        played = Play(index, seen, None if mask is None else mask[0], checked[0])
        if self._recorder is not None:
            self._recorder.turn([played])
        if self._watch is not None:
            self._watch(tick, played)
        hides = labs.scenario.hides  # exact scores and amounts would be readings free of charge
        for agent, score in zip(labs.agents, labs.scores[0].tolist(), strict=True):
            if score == score and agent in self.seats and agent != MANAGER_AGENT:
                self._notices[agent].append("Experiment over" + ("." if hides else f": score {score:+.3f}."))
        if labs.agents[index] in self.seats:
            events = labs.events(index).items()
            described = [event_words(kind, amount) for kind, amount in events]
            told = [one[0] if hides else " ".join(one) for one in described]
            self._notices[labs.agents[index]] += [f"Safety event: {words}." for words in told]

    def play(self, agent: str, action: Any) -> None:
        """Play the current turn of a seat with an action of the background policy.

        An invalid action has no effect, as in the environments.
        """
        with self._changed:
            labs = self.laboratories
            mask = labs.mask(labs.agents.index(agent), labs.members)
            self._take_turn(agent, action, mask, self._background)
            self._notices[agent] = []
            self._advance()
            self._close_files()

    def _take_turn(self, agent: str, action: Any, mask: Any, player: str = "seat") -> None:
        """Play and count a turn of a seat; ``mask`` [1, actions] has the legal actions, None for continuous ones."""
        if self._recorder is not None:
            self._recorder.played_by(agent, player)
        self._play(self.laboratories.agents.index(agent), action)
        if mask is None or mask[0, int(action)]:
            self._views[agent].acted(action)
        self._turns[agent] += 1
        self._fresh[agent] = False

    def display(self, agent: str) -> str:
        """Return a seat's complete observation in words, without counting a call."""
        with self._changed:
            return self._end_words() if self._over else self._display(agent, True, "")

    # -- calls --------------------------------------------------------------------------------------------------------

    def call(
        self, agent: str, verb: str, arguments: Mapping[str, Any] | None = None, count: int | None = None
    ) -> Reply:
        """Carry out a call of a seat, and return the reply; invalid input of any kind is refused in the reply.

        Args:
            agent: the seat.
            verb: name of the verb.
            arguments: arguments by name. With ``turn``, the number of the turn, a repeated call has no further effect.
                ``reason``, a text of at most 200 characters, is only written to the transcript.
            count: number of given arguments, if it exceeds that of the verb.
        """
        with self._changed:
            if not isinstance(agent, str) or agent not in self.seats:
                return Reply(f"no seat {plain(agent)}; seats: {', '.join(self.seats)}", self._over, True)
            if self._over:
                return Reply(self._end_words(), True)
            counts = self._counts[agent]
            counts["calls"] += 1
            if self._budget is not None and counts["calls"] > self._budget:
                self._finish("out of calls")
                self._close_files()
                return Reply(self._end_words(), True)
            episode, played = self._episode, self._played
            arguments = {} if arguments is None else arguments
            try:
                if count is not None:
                    raise ToolError(f"{verb}: {self._verbs[agent][verb].takes}, given {count}")
                reply = self._answer(agent, verb, arguments)
            except ToolError as error:
                counts["wrong"] += 1
                reply = Reply(f"Error: {error}", self._over, True)
            if episode == self._episode:
                counts["characters"] += len(reply.text)
                shown = {plain(k): plain(v, 1000) for k, v in arguments.items()} if _is_small(arguments) else {}
                at = min(self._played, played + 1)  # number of the call's turn in the record
                entry = {"at": at, "agent": agent, "verb": plain(verb), "arguments": shown, **asdict(reply)}
                self._transcript.append(entry)
                self._close_files()
            return reply

    def _answer(self, agent: str, verb: str, arguments: Mapping[str, Any]) -> Reply:
        """Carry out a call, and return the reply; ToolError if it is refused."""
        if not _is_small(arguments):
            example = f'an object of at most {_MOST_ARGUMENTS} values by name, such as {{"slot": 0}}'
            raise ToolError(f"{plain(verb)}: arguments must be {example}")
        verbs = self._verbs[agent]
        if not isinstance(verb, str) or verb not in verbs:
            raise ToolError(f"unknown verb {plain(verb)}; verbs: {', '.join(verbs)}")
        given = dict(arguments)
        turn, reason = given.pop("turn", None), given.pop("reason", "")
        if not isinstance(reason, str) or len(reason) > _LONGEST_REASON:
            most = f"at most {_LONGEST_REASON} characters"
            raise ToolError(f"{verb}: reason must be a text of {most}, given {amount_of(reason)}")
        values = verbs[verb].checked(given)
        if verb == "look":
            return Reply(self._display(agent, True, values.get("at", "all")))
        if verb == "say":
            return self._deliver(agent, values["to"], values["text"])
        repeated = None if turn is None else self._repeated(agent, verb, values, turn)
        if repeated is not None:
            return repeated
        if self._current() != agent:
            if verb != "wait":
                return Reply(f"Not your turn: {self._current()} has it; nothing was done. Call wait.")
            self._changed.wait_for(lambda: self._over or self._current() == agent, self._patience)
            return Reply(self._situation(agent), self._over)
        action = verbs[verb].action
        if action is None or (verb == "wait" and self._fresh[agent]):  # the seat has not yet been shown its turn
            return Reply(self._situation(agent))
        reply = self._act(agent, verb, action(values))
        self._last[agent] = (self._turns[agent] - 1, verb, values, reply)
        return reply

    def _repeated(self, agent: str, verb: str, values: Mapping[str, Any], turn: Any) -> Reply | None:
        """Return the earlier reply to a call of the previous turn, or None for the current turn; else ToolError."""
        number, now = number_of(turn), self._turns[agent]
        if number == now:
            return None
        last = self._last.get(agent)
        if last is not None and number == last[0] and (verb, values) == last[1:3]:
            return last[3]
        raise ToolError(f"{verb}: turn must be {now}, the current turn, or left out; given {plain(turn)}")

    def _act(self, agent: str, verb: str, action: Any) -> Reply:
        """Play a seat's action and the following turns of policies; ToolError if the action is illegal."""
        labs = self.laboratories
        mask = labs.mask(labs.agents.index(agent), labs.members)
        if mask is not None and not mask[0, int(action)]:
            raise ToolError(self._impossible(agent, verb, mask[0]))
        before = sum(labs.costs().values())
        self._take_turn(agent, action, mask)
        price = sum(labs.costs().values()) - before
        done = f"Done; cost {price:.4g}. " if agent == MANAGER_AGENT and price > 5e-7 else "Done. "
        self._advance()
        situation = self._situation(agent)
        if agent != MANAGER_AGENT and self._current() == agent:  # an experiment continues
            done = ""
        return Reply(f"{done}{situation}", self._over)

    def _situation(self, agent: str) -> str:
        """Return a seat's new notices, and the changes of its observation or the agent that has the turn."""
        notices = " ".join(self._notices[agent])
        self._notices[agent] = []
        if self._over:
            return f"{notices} {self._end_words()}".strip()
        if self._current() != agent:
            return f"{notices} {self._current()} has the turn; call wait.".strip()
        return f"{notices} {self._display(agent, False)}".strip()

    def _display(self, agent: str, whole: bool, at: str = "all") -> str:
        """Return the seat's ``whole`` observation in words, or the lines that have changed since the last reply.

        ``at`` is a slot, or ``orders``, to show only this part, in detail; ``all``: without details that the seat was
        already shown; "": with all details.
        """
        labs = self.laboratories
        index = labs.agents.index(agent)
        seen, view = labs.observe(index, labs.members)[0], self._views[agent]
        if at not in ("", "all"):
            return "\n".join(folded_lines(view.lines(seen, only="goal" if at == "orders" else f"slot_{at}")))
        lines = view.lines(seen if whole else self._without_small_changes(agent, seen), whole)
        self._last_seen[agent] = seen
        role = labs.roles[index]
        head, had = f"Turn {self._turns[agent]}", int(role.turns_had[0])
        if isinstance(role, BenchRole):
            whole = whole or had == 0
            if not role.experiments.busy[0]:
                head, lines = f"{head}: no experiment here", []
            elif whole:
                head += f": step {had + 1} of {role.workplace.spec.step_limit}"
        before, self._shown[agent] = self._shown[agent], set(lines)
        shown = lines if whole else [line for line in lines if line not in before]
        if at:  # earlier readings of vessels at benches are details, too
            shown = [(subject, words.partition(" (before: ")[0]) for subject, words in shown]
        if self._current() == agent:
            self._fresh[agent] = False
        else:
            head += f"; {self._current()} has the turn"
        return "\n".join([head, *folded_lines(shown, before if whole and at else ())])

    def _without_small_changes(self, agent: str, observation: Any) -> Any:
        """Return the observation, in which spectra that have hardly changed are replaced by those last shown."""
        last = self._last_seen.get(agent)
        if last is None:
            return observation
        channels = self.laboratories.roles[self.laboratories.agents.index(agent)].channels
        columns = channel_slices(channels)
        for part in [columns[channel.name] for channel in channels if channel.unit == "absorption"]:
            if np.abs(observation[part] - last[part]).max() <= _UNNOTICED:
                observation[part] = last[part]
        return observation

    def _impossible(self, agent: str, verb: str, mask: Any) -> str:
        """Return the error text for an illegal action, with the legal arguments of its verb or the legal verbs."""
        ways = {one.name: [given for given, action in one.ways() if mask[action]] for one in self.verbs(agent)}
        if not ways[verb]:
            possible = ", ".join(name for name, legal in ways.items() if legal)
            return f"{verb}: not possible now; possible verbs: {possible}"
        columns = {name: dict.fromkeys(str(given[name]) for given in ways[verb]) for name in ways[verb][0]}
        listed = "; ".join(f"{name} {', '.join(values)}" for name, values in columns.items())
        return f"{verb}: not possible with these arguments now; possible: {listed}"

    def _deliver(self, agent: str, to: str, text: str) -> Reply:
        """Add a message to another seat's notices; ToolError if it has more characters than are left."""
        left = self._say - self._said[agent]
        if len(text) > left:
            raise ToolError(f"say: {len(text)} characters, but only {left} are left of {self._say}")
        self._said[agent] += len(text)
        self._notices[to].append(f"{agent} says: {json.dumps(text, ensure_ascii=False)}.")
        return Reply(f"Sent; {self._say - self._said[agent]} characters left.")

    def _end_words(self) -> str:
        """Return the outcome of the episode in words."""
        labs = self.laboratories
        outcome, costs = labs.outcome(), sum(labs.costs().values())
        delivered = f"delivered {outcome['submitted_mol']:.3f} mol at purity {outcome['purity']:.3f}"
        return f"The episode is over ({self._status}): {delivered}, costs {costs:.4f}, score {self.score:.3f}."

    def brief(self, seat: str) -> str:
        """Return the introduction for a seat: task, score, prices, hidden parameters."""
        return brief(self.laboratories, seat, self.seats, self._name)


def _commitment(salt: str | None, seed: int | None) -> str:
    return hashlib.sha256(f"{salt}:{seed}".encode()).hexdigest()


def call_of(text: str) -> tuple[str, dict[str, Any]]:
    """Return verb and arguments of the last ``{"verb": ..., "arguments": {...}}`` in a text; ("", {}) without a call.

    Only the last 10,000 characters are searched.
    """
    decoder, call = json.JSONDecoder(), ("", dict[str, Any]())
    text = text[-_LONGEST_ANSWER:]
    at = text.find("{")
    while at >= 0:
        try:
            value, end = decoder.raw_decode(text, at)
        except (ValueError, RecursionError):
            value, end = None, at + 1
        if isinstance(value, dict) and isinstance(value.get("verb"), str):
            call = value["verb"], value.get("arguments", {})
        at = text.find("{", end)
    return call


def _is_small(arguments: Any) -> bool:
    """Return True for a mapping of at most ``_MOST_ARGUMENTS`` names."""
    is_few = isinstance(arguments, Mapping) and len(arguments) <= _MOST_ARGUMENTS
    return is_few and all(isinstance(key, str) for key in arguments)


# -- interface for frameworks -----------------------------------------------------------------------------------------

_TURN = "number of the turn that the call is for; if the call is repeated, it has no further effect"


def input_schema(verb: Verb) -> dict[str, Any]:
    """Return the JSON schema of a verb's arguments."""
    properties: dict[str, Any] = {}
    for argument in verb.arguments:
        schema: dict[str, Any] = {"description": argument.meaning}
        if argument.options:
            kind = "string" if isinstance(argument.options[0], str) else "integer"
            schema |= {"type": kind, "enum": list(argument.options)}
        elif argument.longest:
            schema |= {"type": "string", "maxLength": argument.longest}
        else:
            schema |= {"type": "number", "minimum": argument.low, "maximum": argument.high}
        properties[argument.name] = schema | ({} if argument.default is None else {"default": argument.default})
    if verb.action is not None:
        properties["turn"] = {"type": "integer", "description": _TURN}
    required = [argument.name for argument in verb.arguments if argument.default is None]
    return {"type": "object", "properties": properties, **({"required": required} if required else {})}


class LabTools:
    """A seat with its verbs as public methods (typed, with docstrings), beside ``reset`` and ``get_reward``.

    Args:
        room: the room.
        agent: the seat.

    Raises:
        ValueError: the agent has no seat.
    """

    def __new__(cls, room: Room, agent: str) -> "LabTools":
        """Return an instance of a subclass with the seat's verbs as methods; equal verbs have the same subclass."""
        if agent not in room.seats:
            raise ValueError(f"seat: must be one of {', '.join(room.seats)}, given {agent!r}")
        verbs = room.verbs(agent)
        key = cls, agent, json.dumps(room.tools(agent))
        if key not in _SUBCLASSES:
            _SUBCLASSES[key] = type(f"LabTools_{agent}", (cls,), {verb.name: _method(verb) for verb in verbs})
        return object.__new__(_SUBCLASSES[key])

    def __init__(self, room: Room, agent: str) -> None:
        self._room, self._agent = room, agent

    def reset(self, **row: Any) -> str:
        """Begin an episode; one that runs is kept if this seat has not called in it, and if it has the goal.

        Args:
            row: a row of a data set; ``goal`` is the goal of the episode (default: any), other keys are ignored.

        Returns:
            The introduction, and the seat's complete observation.
        """
        goal, labs = row.get("goal"), self._room.laboratories
        goal = goal if isinstance(goal, str) else None
        other = goal is not None and {goal} != {labs.scenario.goals[number] for number in labs.state.goal[0].tolist()}
        if other or self._room.over or self._room.report()["seats"][self._agent]["calls"]:
            self._room.begin(goal)
        return f"{self._room.brief(self._agent)}\n\n{self._room.call(self._agent, 'look').text}"

    def get_reward(self) -> float:
        """End the episode for all seats, and return the raw score: during the episode it would be a free reading."""
        self._room.close()
        return self._room.score


_SUBCLASSES: dict[tuple[type[LabTools], str, str], type[LabTools]] = {}


def _method(verb: Verb) -> Callable[..., str]:
    """Return a verb as a method of :class:`LabTools` with a signature and a docstring in Google style."""
    kind = inspect.Parameter
    parameters = [kind("self", kind.POSITIONAL_OR_KEYWORD)]
    for argument in verb.arguments:
        annotation = Literal.__getitem__(argument.options) if argument.options else str if argument.longest else float
        default = kind.empty if argument.default is None else argument.default
        parameters.append(kind(argument.name, kind.POSITIONAL_OR_KEYWORD, annotation=annotation, default=default))
    lines = [f"    {argument.name}: {argument.meaning}" for argument in verb.arguments]
    if verb.action is not None:
        turn = Optional[int]  # noqa: UP045 - frameworks may not support int | None
        parameters.append(kind("turn", kind.POSITIONAL_OR_KEYWORD, annotation=turn, default=None))
        lines.append(f"    turn: {_TURN}")
    names = [parameter.name for parameter in parameters[1:]]

    def method(self: LabTools, *values: Any, **given: Any) -> str:
        if len(values) > len(names):
            reply = self._room.call(self._agent, verb.name, given, len(values) + len(given))
        else:
            reply = self._room.call(self._agent, verb.name, {**dict(zip(names, values, strict=False)), **given})
        if reply.error:
            raise ToolError(reply.text)
        return reply.text

    method.__name__ = method.__qualname__ = verb.name
    arguments = "\n\nArgs:\n" + "\n".join(lines) if lines else ""
    method.__doc__ = f"{verb.meaning}{arguments}\n\nReturns:\n    the result, and the changes of your observation"
    method.__signature__ = inspect.Signature(parameters, return_annotation=str)  # type: ignore[attr-defined]
    method.__annotations__ = {p.name: p.annotation for p in parameters[1:]} | {"return": str}
    return method
