"""Commands on training: train, sweep, export."""

from __future__ import annotations

import inspect
import json
import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from rich.box import SIMPLE
from rich.live import Live
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Column, Table
from typer.core import TyperCommand

from ..config.files import check_folder
from .options import AddressOption, JsonOption, ProcessesOption, TrustOption, app
from .screen import err, out, page, plain

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ..agents.runs import Evaluation, RunResult
    from ..agents.train.sweep import Planned, Status

# -- train ------------------------------------------------------------------------------------------------------------


_CURVE = 24
"""Characters of the curve in the terminal."""


class _Account:
    """A progress bar with the remaining time and the curve of returns; without a terminal, a line per evaluation."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress
        self._task = TaskID(0)
        self._steps = 0
        self._curve: dict[int, float] = {}
        self._note = ""

    def _say(self, text: str) -> None:
        # Print a line at once, so that a log shows the run's folder.
        console = self._progress.console if self._progress is not None else err
        console.print(text)

    def cloning(self, policy: str) -> None:
        """See :class:`chemlab.agents.train.loop.Watcher`."""
        self._say(f"cloning {policy}, which can take a minute")

    def begun(self, step: int, steps: int) -> None:
        """See :class:`chemlab.agents.train.loop.Watcher`."""
        self._steps = steps
        if step:
            self._say(f"resuming at step {step:,} of {steps:,}")
        if self._progress is not None:
            self._task = self._progress.add_task("training", total=steps, completed=step, mean="")

    def advanced(self, step: int, mean: float | None, note: str = "") -> None:
        """See :class:`chemlab.agents.train.loop.Watcher`."""
        if self._progress is None:
            return
        if mean is not None:
            self._curve[min(_CURVE * step // self._steps, _CURVE - 1)] = mean
            ascii_only = self._progress.console.options.ascii_only
            levels = " .:-=+*#@" if ascii_only else " ▁▂▃▄▅▆▇█"
            note = f"return {mean:.3f} {_curve(self._curve, levels)}"
        self._note = f", {note}" if note else self._note  # in some rounds no episode ends
        self._progress.update(self._task, completed=step, mean=f"{step:,} steps{self._note}")

    def evaluated(self, evaluation: Evaluation, best: bool) -> None:
        """See :class:`chemlab.agents.train.loop.Watcher`."""
        scripted = evaluation.scripted_mean
        beside = "" if scripted is None else f", scripted {scripted:.3f}"
        if evaluation.other_mean is not None:
            ways = ("sampled", "greedy") if evaluation.sampled else ("greedy", "sampled")
            beside = f" {ways[0]}, {evaluation.other_mean:.3f} {ways[1]}{beside}"
        self._say(f"step {evaluation.step:>9,}: mean return {evaluation.mean:.3f}{beside}{'  (best)' if best else ''}")

    def finishing(self) -> None:
        """See :class:`chemlab.agents.train.loop.Watcher`."""
        if self._progress is not None:
            self._progress.update(self._task, mean="last evaluation")


def _curve(means: dict[int, float], levels: str) -> str:
    """Draw mean returns by position between 0 (or the lowest below it) and the highest; the first level is none."""
    low, high = min(0.0, *means.values()), max(0.0, *means.values())
    scale = (len(levels) - 2) / (high - low) if high > low else 0.0
    drawn = {at: levels[1 + round(scale * (mean - low))] for at, mean in means.items()}
    return "".join(drawn.get(at, levels[0]) for at in range(max(means) + 1))


def _watched(folder: Path, quiet: bool, as_json: bool, run: Callable[[Any], RunResult]) -> None:
    """Train with progress on standard error, then print the result."""
    from ..agents.runs import Run

    known = Run(folder).result_file.exists()
    silent = quiet or as_json or not err.is_terminal
    bar = BarColumn(None, table_column=Column(ratio=1))
    clocks = [kind(table_column=Column(no_wrap=True)) for kind in (TimeElapsedColumn, TimeRemainingColumn)]
    means = TextColumn("{task.fields[mean]}", table_column=Column(ratio=3, no_wrap=True))
    columns = (bar, TextColumn("{task.percentage:>3.0f} %"), clocks[0], TextColumn("left"), clocks[1], means)
    try:
        if silent:
            result = run(None if as_json else _Account(None))
        else:
            with Progress(*columns, console=err, expand=True) as progress:
                result = run(_Account(progress))
    except KeyboardInterrupt:
        err.print(f"stopped; the same command resumes from the last checkpoint in {plain(folder)}")
        raise typer.Exit(130) from None
    if as_json:
        typer.echo(json.dumps({**asdict(result), "folder": str(folder)}))
        return
    if known:
        out.print(f"{plain(folder)} is finished; nothing to do")
    out.print(_outcome(result))
    out.print(f"best checkpoint (step {result.best_step:,}) and everything else: {plain(folder)}")


def _outcome(result: RunResult) -> Table:
    title = f"{result.env_id}, {result.label}, seed {result.seed}: {result.steps:,} steps in {result.seconds:,.0f} s"
    ways = (result.sampled, result.last_sampled)
    table = Table(title=plain(f"{title} (mean return of {result.episodes_per_goal} episodes)"), box=SIMPLE)
    best, last = (f"{name}, sampled" if way else name for name, way in zip(("best", "last"), ways, strict=True))
    for name in ("goal", best, last, "scripted"):
        table.add_column(name, justify="left" if name == "goal" else "right")
    scripted = result.scripted_by_goal or {}
    for goal, value in result.by_goal.items():
        table.add_row(plain(goal), f"{value:.3f}", f"{result.last_by_goal[goal]:.3f}", _number(scripted.get(goal)))
    table.add_row("mean", f"{result.mean:.3f}", f"{result.last_mean:.3f}", _number(result.scripted_mean))
    return table


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


_FIRST = ("roles", "bench", "algo")
_OLD_OPTIONS = {"imitate": str, "imitate_steps": int, "scenario": str}


def _options() -> list[Any]:
    """Make an option for each argument of each algorithm."""
    from ..agents.train.arguments import ABOUT, ALGORITHMS, PRESETS, Arguments, Single

    found: dict[str, dict[str, Any]] = {name: {} for name in (*_FIRST, *Arguments.model_fields)}
    for algo, model in ALGORITHMS.items():
        for name, field in model.model_fields.items():
            found.setdefault(name, {})[algo] = field
    del found["scenario"]
    one = [algo for algo, model in ALGORITHMS.items() if issubclass(model, Single)]
    choices = {"algo": ", ".join(ALGORITHMS), "preset": ", ".join(PRESETS)}
    hints = {name: _hint(name, kind, "", hidden=True) for name, kind in _OLD_OPTIONS.items()}
    for name, fields in found.items():
        field, algos = list(fields.values())[-1], list(fields)
        text = f"{ABOUT[name].rstrip('.')}: {choices[name]}." if name in choices else ABOUT[name]
        text += _default_text(fields) if name != "algo" else _WHICH
        others = ", ".join(algo for algo in ALGORITHMS if algo not in algos)
        some = "One agent" if algos == one else min(", ".join(algos), f"All but {others}", key=len)
        shape = str(field.annotation)
        kind: Any = int if "int" in shape else float if "float" in shape else bool if "bool" in shape else str
        hints[name] = _hint(name, list[kind] if "tuple" in shape else kind, text, some if others else "Every algorithm")
    keyword = inspect.Parameter.KEYWORD_ONLY
    made, options = typer.Typer(add_completion=False), lambda **_: None
    options.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, keyword, default=None, annotation=hint) for name, hint in hints.items()]
    )
    options.__annotations__ = hints
    made.command()(options)
    return list(typer.main.get_command(made).params)


_WHICH = " Default: ppo for one bench, ippo for the manager and for several roles."


def _hint(name: str, kind: Any, text: str, panel: str = "", hidden: bool = False) -> Any:
    option = name.replace("_", "-")
    flag = f"--{option}/--no-{option}" if kind is bool else f"--{option}"
    # An option that is not given is None, so that what was given wins over file and preset.
    number: dict[str, Any] = {"parser": _whole, "metavar": "<int>"} if kind is int else {}
    given = typer.Option(flag, help=text, hidden=hidden, show_default=False, rich_help_panel=panel or None, **number)
    return Annotated[Optional[kind], given]  # noqa: UP045 - made at run time


def _whole(text: str) -> int:
    """Convert a whole number, also written as 1e6."""
    with suppress(ValueError):
        if (value := float(text)).is_integer():
            return int(value)
    raise typer.BadParameter(f"must be a whole number, such as 1000000 or 1e6; given {text!r}")


def _default_text(fields: dict[str, Any]) -> str:
    """Describe the default of an argument, which may depend on the algorithm."""
    defaults: dict[str, list[str]] = {}
    for algo, field in fields.items():
        value = field.default
        shown = " ".join(map(str, value)) if isinstance(value, tuple) else "" if value is None else str(value)
        defaults.setdefault(shown, []).append(algo)
    (usual, _), *others = sorted(defaults.items(), key=lambda item: -len(item[1]))
    apart = "; ".join(f"{', '.join(algos)}: {value}" for value, algos in others if value)
    return f" Default: {usual}{f' ({apart})' if apart else ''}." if usual else ""


class _Train(TyperCommand):
    """The command with the options of every algorithm, added when they are first needed: pydantic is slow to import."""

    _more: tuple[str, ...] = ()

    def get_params(self, ctx: Any) -> list[Any]:
        if not self._more:
            options = _options()
            self._more = tuple(option.name for option in options)
            self.params += options
        return super().get_params(ctx)

    def invoke(self, ctx: Any) -> Any:
        ctx.obj = {name: ctx.params.pop(name) for name in self._more}
        return super().invoke(ctx)


def _given(values: dict[str, Any], target: str) -> dict[str, Any]:
    """Return the arguments that were given; an old ``--scenario`` says the scenario of an environment id."""
    flags = {name: value for name, value in values.items() if value is not None and value not in ((), [])}
    return {**flags, "env_id": target} if "scenario" in flags else {**flags, "scenario": target}


@app.command(cls=_Train)
def train(
    ctx: typer.Context,
    target: Annotated[
        str,
        typer.Argument(
            metavar="scenario",
            help="A scenario (name or path), or the id of an environment of one agent (chemlab/WurtzReaction-v0).",
        ),
    ],
    config: Annotated[
        Optional[Path],  # noqa: UP045 - read at run time
        typer.Option("--config", help="TOML file with any of these arguments; flags override it.", show_default=False),
    ] = None,
    folder: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--out", help="The run's folder. Default: runs/TASK/ALGO/seed-SEED.", show_default=False),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress bar; one line per evaluation.")] = False,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Train a bench, an agent of a laboratory, or several roles together; an interrupted run resumes.

    --bench trains a bench on its own. --roles trains one agent in its laboratory, or several (ippo and mappo). Without
    either, all roles learn. For a bench on its own, defaults follow the paper's protocol. The run's folder contains its
    configuration, learning curve, evaluations beside the scripted policy, checkpoints, TensorBoard logs, and at the
    end result.json.
    """
    from ..agents.runs import Run
    from ..agents.train.arguments import load_arguments

    arguments = load_arguments(config, _given(ctx.obj, target))
    place = folder or Path("runs") / arguments.folder()
    if not Run(place).result_file.exists():  # the folder of a finished run is only read
        check_folder(place)
    from ..agents.train import learn

    _watched(place, quiet, as_json, lambda watcher: learn.train(arguments, place, watcher))


# -- sweep ------------------------------------------------------------------------------------------------------------

_COLOURS = {"done": "green", "running": "cyan", "failed": "red", "other": "red", "interrupted": "yellow"}


@app.command()
def sweep(
    file: Annotated[Path, typer.Argument(help="Sweep file (TOML; examples: studies/baselines/).")],
    processes: ProcessesOption = None,
    address: AddressOption = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder of results.")] = Path("results"),
    status: Annotated[bool, typer.Option("--status", help="Show the state of the sweep and run nothing.")] = False,
    trust: TrustOption = False,
    as_json: JsonOption = False,
) -> None:
    """Train all runs of a sweep file; finished runs are skipped, interrupted ones resumed."""
    from ..agents.executors import executor
    from ..agents.train.sweep import plan, run_sweep, status_of

    runs = plan(file, folder)
    if status:
        found = [status_of(one) for one in runs]
    else:
        from ..agents.train import learn as training  # noqa: F401 - report a missing extra only once

        # Terminating a sweep terminates its runs, as an interruption does.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            with executor(address, processes, commands=True) as jobs:
                found = run_sweep(runs, jobs, lambda _: None) if as_json else _live(runs, jobs)
        except KeyboardInterrupt:
            err.print("stopped; the same command resumes")
            raise typer.Exit(130) from None
    if as_json:
        rows = [{"run": one.name, **asdict(now)} for one, now in zip(runs, found, strict=True)]
        typer.echo(json.dumps(rows, indent=1))
    elif status:
        page.print(_table(runs, found, every=True))
    if any(now.state in ("failed", "other") for now in found) and not status:
        raise typer.Exit(1)


def _live(runs: list[Planned], jobs: Executor) -> list[Status]:
    """Run with a live table; without a terminal, print a line for each change of a run's state."""
    from ..agents.train.sweep import run_sweep

    if out.is_terminal:
        with Live(console=out, auto_refresh=False) as live:
            ended: list[Status] = run_sweep(runs, jobs, lambda now: live.update(_table(runs, now), refresh=True))
            return ended
    states: dict[str, str] = {}

    def tell(found: list[Status]) -> None:
        for one, now in zip(runs, found, strict=True):
            if states.get(one.name, "waiting") != now.state:
                out.print(f"{now.state:<11} {one.name}  {_number(now.mean)} {now.note}".rstrip(), markup=False)
            states[one.name] = now.state

    ended = run_sweep(runs, jobs, tell)
    return ended


def _table(runs: list[Planned], found: list[Status], every: bool = False) -> Table:
    """Return a table of all runs, or only of running, failed, last finished and next queued ones."""
    counts = {state: sum(now.state == state for now in found) for state in dict.fromkeys(s.state for s in found)}
    table = Table(title=", ".join(f"{count} {state}" for state, count in counts.items()), box=SIMPLE)
    for name in ("run", "state", "step", "of", "mean return", ""):
        table.add_column(name, justify="right" if name in ("step", "of", "mean return") else "left", overflow="fold")
    shown: dict[str, int] = {}
    for one, now in zip(runs, found, strict=True):
        shown[now.state] = shown.get(now.state, 0) + 1
        hidden = counts["done"] - shown["done"] >= 8 if now.state == "done" else shown[now.state] > 8
        if hidden and not every and now.state != "running":
            continue
        colour = _COLOURS.get(now.state, "dim")
        state = f"[{colour}]{now.state}[/{colour}]"
        numbers = f"{now.step:,}", f"{now.steps:,}", _number(now.mean)
        table.add_row(plain(one.name), state, *numbers, plain(now.note))
    return table
