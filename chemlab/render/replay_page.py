"""A record as an interactive page: one self-contained HTML file that makes no network requests.

The record is replayed on the simulator, and the page draws the scenes of :mod:`chemlab.render.scene`. Scenes change
little between turns. The page therefore stores every distinct part once (:class:`_Pool`), and a frame refers to its
parts. Any frame can be shown without the earlier ones.
"""

from __future__ import annotations

import base64
import dataclasses
import functools
import hashlib
import html
import json
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Any

from pydantic import BaseModel, ConfigDict

from ..config.datafile import DataError, read_text
from ..config.scenario import Scenario
from ..lab.engine import Laboratories
from ..lab.text import action_words, event_words, reading_words
from ..physics.chemistry import WAVELENGTHS_NM
from ..physics.transfer import liquid_volume
from ..record import LIMITS, Play, Record, RecordError, Replay, verify_record
from ..record.recorder import turn_facts
from ..roles.manager_actions import SECOND
from ..roles.manager_state import COST_WORDS
from .scene import Camera, Scene, laboratory_scene

_DIGITS = 4
_LONG = 30
"""Lists of numbers in [0, 1] of at least this length (spectra, pictures) are stored in thousandths."""
_STATIC = ("kind", "scenario", "title", "materials", "largest_capacity_l", "temperature_range_k", "costs", "result")
"""Keys that frames omit, because they are constant or stored as columns of numbers."""
_INLINE = 3
"""Longest tuple that is stored inline instead of as an entry of the pool."""
MOST_TURNS = 20_000
"""Maximum number of turns of a page; browsers cannot show longer ones."""


@functools.lru_cache(maxsize=4096)
def _rounded(value: float, digits: int = _DIGITS) -> float:
    return float(f"{value:.{digits}g}")


class _Pool:
    """Pool of distinct values; equal ones are stored once.

    Long lists of numbers are stored in thousandths, mixtures in hundredths, other numbers with :data:`_DIGITS` digits.
    A number or a string represents itself; ``[-2, i]`` is entry i; ``[-1, ...]`` is a list; ``[s, ...]`` is an object
    with the keys ``shapes[s]``.
    """

    def __init__(self) -> None:
        self.shapes: list[tuple[str, ...]] = []
        self.entries: list[tuple[Any, ...]] = []
        self._shape_of: dict[tuple[str, ...], int] = {}
        self._entry_of: dict[tuple[Any, ...], int] = {}
        self._before: dict[Any, Any] = {}
        self._now: dict[Any, Any] = {}

    def frame(self, parts: Mapping[str, Any]) -> Any:
        """Return the packed form of a frame; the packed forms of the previous frame's pictures are reused."""
        self._before, self._now = self._now, {}
        return self._object(tuple(parts), parts.values())

    def _pack(self, value: Any) -> Any:
        """Return the packed form of a picture, a tuple, a number or a text."""
        if isinstance(value, float):
            return _rounded(value)
        keys = _keys(value.__class__)
        if keys is None:
            return value
        packed = self._before.get(value)
        if packed is None:
            if keys:
                packed = self._object(keys, [getattr(value, key) for key in keys])
            elif len(value) >= _LONG and isinstance(value[0], float):
                packed = self._reference((-1, *[round(1000 * item) for item in value]))
            else:
                packed = self._reference((-1, *map(self._pack, value)))
        self._now[value] = packed
        return packed

    def _object(self, keys: tuple[str, ...], values: Iterable[Any]) -> Any:
        shape = self._shape_of.setdefault(keys, len(self.shapes))
        if shape == len(self.shapes):
            self.shapes.append(keys)
        parts = [self._hundredths(v) if k == "mixture" else self._pack(v) for k, v in zip(keys, values, strict=True)]
        return self._reference((shape, *parts))

    def _hundredths(self, mixture: tuple[tuple[float, ...], ...]) -> tuple[Any, ...]:
        slices = (self._reference((-1, *[round(100 * share) for share in part])) for part in mixture)
        return self._reference((-1, *slices))

    def _reference(self, packed: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the packed value itself if it is short, otherwise a reference to its entry."""
        if len(packed) <= _INLINE:
            return packed
        entry = self._entry_of.setdefault(packed, len(self.entries))
        if entry == len(self.entries):
            self.entries.append(packed)
        return (-2, entry)


@functools.cache
def _keys(kind: type) -> tuple[str, ...] | None:
    """Return the field names of a type of picture; an empty tuple for tuples, and None for numbers and texts."""
    if dataclasses.is_dataclass(kind):
        return tuple(field.name for field in dataclasses.fields(kind))
    return () if kind is tuple else None


def _outcome(labs: Laboratories, turn: dict[str, Any], plays: Sequence[Play]) -> str:
    """Describe the outcome of a turn in words."""
    words = ["invalid action: it had no effect"] if turn.get("lost") else []
    for agent, events in turn.get("events", {}).items():
        words += [f"safety, {agent}: {' '.join(event_words(kind, x))}" for kind, x in events.items()]
    for agent, score in turn.get("scores", {}).items():
        meaning = labs.roles[labs.agents.index(agent)].workplace.score_meaning
        words.append(f"experiment of {agent} over: {score:+.3f} {meaning}")
    reading = turn.get("reading")
    if reading:
        words.append(reading_words(labs, reading["slot"], reading["instrument"]))
    if _manager_kind(labs, plays) == "submit" and not turn.get("lost"):
        order = int(labs.actions.table[int(plays[0].action), SECOND])
        mol, purity = labs.state.submitted[0, order].tolist()
        words.append(f"{mol:.3f} mol {labs.scenario.goals[labs.state.goal[0, order]]} at purity {purity:.3f}")
    return "; ".join(words)


def _manager_kind(labs: Laboratories, plays: Sequence[Play]) -> str:
    """Return the kind of the manager's action; an empty text if benches acted."""
    return str(labs.actions.decode(int(plays[0].action))[0]) if plays[0].agent == labs.manager.index else ""


class _Call(BaseModel):
    """A line of a transcript: a call by a language agent, and the reply."""

    model_config = ConfigDict(extra="ignore")

    at: int
    agent: str
    verb: str
    arguments: dict[str, Any]
    text: str
    error: bool

    def words(self) -> list[Any]:
        """Return turn, agent, call, reason, reply, and whether the call was rejected."""
        given = {name: value for name, value in self.arguments.items() if name != "reason"}
        call = f"{self.verb} {' '.join(f'{name}={value}' for name, value in given.items())}".strip()
        return [self.at, self.agent, call, str(self.arguments.get("reason", "")), self.text, self.error]


def _calls(record: Record) -> list[list[Any]]:
    """Return the calls of the transcript beside a record; an empty list without a transcript.

    Raises:
        RecordError: the file cannot be read, or is not a transcript.
    """
    path = record.path.with_name(record.path.name.partition(".")[0] + ".transcript.jsonl")
    if not path.is_file():
        return []
    try:
        lines = read_text(path, LIMITS.file_bytes).splitlines()[1:]
        return [_Call.model_validate_json(line).words() for line in lines]
    except DataError as error:
        raise RecordError(f"{error}; move it away, or restore it") from error
    except ValueError as error:
        raise RecordError(f"{path}: is not a transcript; move it away, or restore it") from error


class Film:
    """The scenes of an episode as data of a page: one at the beginning, and one after every turn.

    Args:
        laboratories: a single laboratory after its reset; it is not changed.
    """

    def __init__(self, laboratories: Laboratories) -> None:
        self._labs, self._pool = laboratories, _Pool()
        self._camera = Camera(laboratories.scenario, laboratories.shelf)
        self._first = laboratory_scene(laboratories, camera=self._camera)
        self._frames: list[Any] = []
        self._costs: list[list[float]] = []
        self._results: list[float] = []
        self._turns: list[dict[str, Any]] = []
        self._experiments: list[dict[str, Any]] = []
        self._running: dict[str, dict[str, Any]] = {}
        self._show(self._first)

    def _show(self, scene: Scene) -> None:
        """Add a scene."""
        labs, chem = self._labs, self._labs.shelf.chem()
        frame = {field.name: getattr(scene, field.name) for field in dataclasses.fields(scene)}
        # Spectra are drawn from amounts per litre of liquid; the volume is stored because amounts alone do not
        # determine it. Each is a list of its own: a long list of numbers would be stored in thousandths.
        frame["liquid_l"] = tuple((liquid_volume(row, chem),) for row in labs.shelf.vessels[0])
        self._frames.append(self._pool.frame({key: part for key, part in frame.items() if key not in _STATIC}))
        # With more digits than the page shows: a number that is rounded twice may differ from that of the record.
        self._costs.append([_rounded(cost, 7) for cost in labs.costs().values()])
        self._results.append(_rounded(labs.result(labs.members)[0], 7))  # also where agents do not know it yet

    def add(self, tick: int, plays: Sequence[Play]) -> None:
        """Add the scene after a turn.

        Args:
            tick: laboratory tick before the turn.
            plays: the actions, in the agents' order.
        """
        labs, number, turn = self._labs, len(self._turns) + 1, _turn(self._labs, plays)
        actions = [[play.agent, action_words(labs, play.agent, play.action)] for play in plays]
        kind, outcome = _manager_kind(labs, plays), _outcome(labs, turn, plays)
        self._turns.append({"tick": tick, "plays": actions, "kind": kind, "outcome": outcome, **turn})
        scene = laboratory_scene(labs, camera=self._camera)
        for agent, score in turn.get("scores", {}).items():
            if agent in self._running:
                self._running.pop(agent).update(end=number, score=score)
        for bench in scene.benches:
            if bench.busy and bench.agent not in self._running:
                new = {"agent": bench.agent, "start": number, "end": None, "goal": bench.goal, "score": None}
                self._running[bench.agent] = new
                self._experiments.append(new)
        self._show(scene)

    @property
    def turns(self) -> int:
        """Number of turns so far."""
        return len(self._results) - 1

    def still(self) -> dict[str, Any]:
        """Return the data that are constant during the episode."""
        labs, scene, table = self._labs, self._first, self._labs.instruments
        scenario = labs.scenario
        peaks = {
            name: [[peak.height_l_mol, peak.center_nm, peak.width_nm] for peak in material.absorption]
            for name, material in scenario.materials.items()
        }
        return {
            "title": scenario.title,
            "scenario": scenario.name,
            "summary": scenario.summary,
            "agents": labs.agents,
            "limits": {"ticks": scenario.limits.ticks, "manager_actions": scenario.limits.manager_actions},
            "materials": [{**vars(picture), "peaks": peaks[picture.name]} for picture in scene.materials],
            "largest_capacity_l": _rounded(scene.largest_capacity_l),
            "wavelengths_nm": [float(WAVELENGTHS_NM[0]), float(WAVELENGTHS_NM[-1]), len(WAVELENGTHS_NM)],
            "analytes": {
                name: [*analytes, kind.rest]
                for name, analytes, kind in zip(table.names, table.analytes, table.kinds, strict=True)
                if kind.picture == "bars"
            },
            "reagents": {
                agent: list(getattr(bench, "reagent_names", ()))
                for agent, bench in zip(labs.bench_agents, labs.benches, strict=True)
            },
            "positions": [
                *(f"slot_{s}" for s in range(scenario.shelf.slots)),
                *(f"{role.name}.{place}" for role in labs.bench_roles for place in role.workplace.positions),
            ],
            "cost_items": list(COST_WORDS),
            "hidden": _world_rows(labs.worlds.values(0)) if labs.worlds.active else [],
        }

    def since(self, turns: int = -1, shapes: int = 0, pool: int = 0) -> dict[str, Any]:
        """Return the data that were added after a number of turns, and all experiments.

        Another thread may add a turn meanwhile; a turn is returned only when it is complete.

        Args:
            turns: number of turns that the page already has; -1 if it does not have the beginning.
            shapes, pool: numbers of shapes and entries of the pool that the page already has.
        """
        complete = self.turns
        return {
            "turns": self._turns[max(turns, 0) : complete],
            "frames": self._frames[turns + 1 : complete + 1],
            "costs": self._costs[turns + 1 : complete + 1],
            "results": self._results[turns + 1 : complete + 1],
            "experiments": [dict(experiment) for experiment in self._experiments],
            "shapes": self._pool.shapes[shapes:],
            "pool": self._pool.entries[pool:],
        }


def _world_rows(draws: dict[str, Any]) -> list[list[str]]:
    """Return hidden parameters as rows of name and value."""
    rows = []
    for name, drawn in draws.items():
        targets = drawn if isinstance(drawn, dict) else {"": drawn}
        for target, value in targets.items():
            label = name if len(targets) == 1 else f"{name}, {target}"
            rows.append([label, f"{value:.4g}" if isinstance(value, float) else str(value)])
    return rows


def replay_data(record: Record, trust: bool = False, scenario: Scenario | None = None) -> dict[str, Any]:
    """Return the data of the replay page as JSON data; ``replay.html`` reads it.

    Args:
        record: a record, finished or not. The calls of a transcript beside it (``NAME.transcript.jsonl``) are included.
        trust: allow imports of code that the record names.
        scenario: required scenario of the record; None: the bundled one of the same name.

    Raises:
        RecordError: the record cannot be replayed here, or its transcript cannot be read.
    """
    replay = Replay(record, trust, beside=scenario)
    film, stopped = Film(replay.laboratories), ""
    for recorded in record.turns:
        tick = int(replay.laboratories.state.ticks[0])
        try:
            plays = replay.play(recorded)
        except (ValueError, TypeError) as error:
            stopped = str(error)
            break
        film.add(tick, plays)  # consequences are those of the replay, not of the file
    verified, seed = verify_record(record, scenario, trust), record.header.get("seed")
    return {
        **film.still(),
        "seed": None if seed is None else str(seed),  # JavaScript's numbers have 53 bits
        "version": record.header.get("chemlab"),
        "policies": record.header.get("policies"),
        "verified": {"status": verified.status, "message": verified.message},
        "stopped": stopped,
        "calls": _calls(record),
        **film.since(),
    }


def _turn(labs: Laboratories, plays: Sequence[Play]) -> dict[str, Any]:
    """Return the non-empty rewards, costs, events and scores of the turn that was just played."""
    facts = turn_facts(labs, 0, plays)
    for key in {"rewards", "cost", "scores"} & facts.keys():
        facts[key] = {agent: float(f"{value:.6g}") for agent, value in facts[key].items()}
    if _manager_kind(labs, plays) and "lost" not in facts:
        kind, *arguments = labs.actions.decode(int(plays[0].action))
        if kind == "measure":
            facts["reading"] = {"slot": arguments[0], "instrument": arguments[1]}
        if kind in ("start", "measure", "discard", "submit"):
            facts["slot"] = arguments[1] if kind == "start" else arguments[0]
    return facts


def replay_page(record: Record, trust: bool = False, scenario: Scenario | None = None) -> str:
    """Return the complete replay page as HTML.

    Arguments and errors are those of :func:`replay_data`; a record with too many turns also raises RecordError.
    """
    if len(record.turns) > MOST_TURNS:
        raise RecordError(f"{record.path}: has {len(record.turns)} turns; a page may have {MOST_TURNS}")
    return filled_page("replay.html", replay_data(record, trust, scenario))


def comparison_page(records: Sequence[Record], trust: bool = False, scenario: Scenario | None = None) -> str:
    """Return the replay pages of several records side by side; the choice of a turn in one sets the clock of all."""
    pages = [replay_page(record, trust, scenario) for record in records]
    frames = {
        f"{number}: {record.path.stem}": f'srcdoc="{html.escape(page)}"'
        for number, (record, page) in enumerate(zip(records, pages, strict=True), start=1)
    }
    script = _content_hash(pages[0], "script")
    return side_by_side(frames, f"default-src 'none'; script-src '{script}'; style-src 'unsafe-inline'; img-src data:")


def side_by_side(frames: Mapping[str, str], policy: str) -> str:
    """Return a page of frames side by side; on a narrow screen they are below each other.

    Args:
        frames: the attribute ``src`` or ``srcdoc`` of each frame, by title.
        policy: content security policy of the page.
    """
    inner = "".join(f'<iframe {page} title="{html.escape(title)}"></iframe>' for title, page in frames.items())
    style = (
        "body{margin:0;display:flex;height:100vh}iframe{flex:1;min-width:0;border:0;border-left:1px solid #888}"
        "@media(max-width:800px){body{flex-direction:column}iframe{border-top:1px solid #888}}"
    )
    head = (
        f'<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}"><link rel="icon" href="data:,">'
        f"<title>{html.escape(' and '.join(frames))}</title><style>{style}</style>"
    )
    return f'<!DOCTYPE html><html lang="en"><head>{head}</head><body>{inner}</body></html>'


def filled_page(name: str, data: Mapping[str, Any], connect: str = "'none'") -> str:
    """Return a page of this folder with its data.

    ``page.html`` has the parts that all pages share; the page's file has its style, body and script.

    Args:
        name: file name of the page.
        data: JSON data; ``title`` and an optional ``seed`` make the page's title.
        connect: permitted connections of the page's script, as a source of a content security policy.
    """
    # Only "</" and "<!--" are special in a script element; JSON can escape "<".
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
    page, file = (files("chemlab.render").joinpath(path).read_text(encoding="utf-8") for path in ("page.html", name))
    body = file.partition("</style>\n")[2].partition("<script>")[0]
    parts = {"CONNECT": connect, "STYLE": _element(file, "style"), "BODY": body, "SCRIPT": _element(file, "script")}
    for mark, part in parts.items():
        page = page.replace(f"__{mark}__", part)
    # The content security policy lets the browser run this page's script only, so that the data cannot add code.
    for mark, element in (("__SCRIPT_HASH__", "script"), ("__STYLE_HASH__", "style")):
        page = page.replace(mark, _content_hash(page, element))
    head, tail = page.split("__DATA__")
    title = f"{data['title']}, seed {data['seed']}" if "seed" in data else data["title"]
    return head.replace("__TITLE__", html.escape(title)) + text + tail


def _element(page: str, name: str) -> str:
    """Return the content of the element with this name and no attributes."""
    return page.split(f"<{name}>")[1].split(f"</{name}>")[0]


def _content_hash(page: str, element: str) -> str:
    """Return the content security policy's hash of the element with this name and no attributes."""
    return "sha256-" + base64.b64encode(hashlib.sha256(_element(page, element).encode()).digest()).decode()
