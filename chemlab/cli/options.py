"""Parts of all commands: the app, shared options, and readable errors."""

from __future__ import annotations

import inspect
import json
import re
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from typer.core import TyperGroup

from .. import __version__
from ..config.datafile import DataError
from ..config.files import check_apart, check_target, write_json
from ..config.inherit import files_of, split_level
from ..config.parts import PartError, strangers_code
from .screen import err, page, plain

if TYPE_CHECKING:
    from ..config.scenario import Scenario
    from ..envs.aec import raw_env


_shown = {"traceback": False}
_RICH = Console.print.__code__.co_filename


@contextmanager
def readable_errors() -> Iterator[None]:
    """Print mistakes of users, files and disks as one line, with exit code 2 or the error's own; no traceback."""
    try:
        yield
    except BrokenPipeError:  # the reader of our output has closed the pipe: click exits quietly
        raise
    except (DataError, ImportError, OSError, ValueError) as error:  # an ImportError names the missing extra
        if _shown["traceback"]:
            raise
        err.print(f"[red]error[/red]: {plain(_message(error))}")
        raise typer.Exit(getattr(error, "exit_code", 2)) from error
    except PartError as error:
        if _shown["traceback"]:
            raise
        if error.__cause__ is not None:  # raised by the part's code, whose author needs the line
            traceback.print_exception(error.__cause__)
        err.print(f"[red]error[/red]: {plain(str(error))}")
        raise typer.Exit(2) from error
    except ArithmeticError as error:
        # Too stiff reactions; other arithmetic errors are defects of chemlab and show their traceback.
        if _shown["traceback"] or type(error) is not ArithmeticError:
            raise
        err.print(f"[red]error[/red]: {plain(str(error))}")
        raise typer.Exit(2) from error


def _message(error: Exception) -> str:
    """Format an error as one line, for system errors with the file first."""
    if isinstance(error, OSError) and error.strerror:
        files = [str(file) for file in (error.filename, error.filename2) if file is not None]
        if not files and _was_printing(error):
            files = ["standard output"]
        return ": ".join([" -> ".join(files), error.strerror] if files else [error.strerror])
    return str(error) or type(error).__name__


def _was_printing(error: BaseException) -> bool:
    """Return whether an error was raised while printing."""
    frames = [frame.f_code for frame, _ in traceback.walk_tb(error.__traceback__)]
    return any(code.co_name == "echo" or code.co_filename == _RICH for code in frames)


FORMER_COMMANDS: dict[str, tuple[str, ...]] = {
    "compare": ("evaluate",),
    "plan": ("audit", "plan"),
    "demos": ("export", "demos"),
    "figures": ("plot", "runs"),
    "starts": ("export", "starts"),
    "train-together": ("train", "--algo", "ippo"),
}
"""Former commands with the words that replace them; they work for one release, with a notice on stderr."""
FORMER_OPTIONS = {"--output": "--out", "--jobs": "--processes"}
"""Former options with their present names, likewise."""
REMOVED_COMMANDS: dict[str, str] = {"train-rllib": "recipes/rllib.py in the repository trains with RLlib"}


def _current_words(args: list[str]) -> list[str]:
    """Replace a former command by its present words, and former options by the present ones."""
    for number, (option, equals, value) in enumerate([word.partition("=") for word in args]):
        if option in FORMER_OPTIONS:
            err.print(f"{option} is now {FORMER_OPTIONS[option]}; the old name ends with this release")
            args[number] = f"{FORMER_OPTIONS[option]}{equals}{value}"
    at = next((i for i, word in enumerate(args) if not word.startswith("-")), None)
    if at is not None and args[at] in REMOVED_COMMANDS:
        raise typer.BadParameter(f"chemlab {args[at]} is no longer a command; {REMOVED_COMMANDS[args[at]]}")
    if at is None or args[at] not in FORMER_COMMANDS:
        return args
    words = FORMER_COMMANDS[args[at]]
    err.print(f"chemlab {args[at]} is now chemlab {' '.join(words)}; the old name ends with this release")
    return [*args[:at], *words, *args[at + 1 :]]


def paragraphs(text: str | None) -> str:
    """Return a help text with each paragraph on one line, to be wrapped to any width."""
    return re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.cleandoc(text or ""))


class DefaultGroup(TyperGroup):
    """A group whose first command is the default."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, "-h", "--help"):
            args = [next(iter(self.commands)), *args]
        return super().parse_args(ctx, args)


class _Commands(TyperGroup):
    """The root group; every error of a command is readable."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        args = _current_words(args)
        # As a path, an empty string would be the current folder.
        for before, word in zip(["", *args], args, strict=False):
            option = before if word == "" else word[:-1]
            if word == "" or re.fullmatch("--[a-z-]+=", word):
                given = f"{option}: " if option.startswith("-") else ""
                raise typer.BadParameter(f"{given}must not be empty; give a value, or omit it for the default")
        with readable_errors():  # for --help, whose text is printed here
            parsed: list[str] = super().parse_args(ctx, args)
        return parsed

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        found = super().get_command(ctx, cmd_name)
        for one in (found, *getattr(found, "commands", {}).values()):
            if one is not None:
                one.help = paragraphs(one.help)
        return found

    def invoke(self, ctx: Any) -> Any:
        with readable_errors():
            return super().invoke(ctx)


app = typer.Typer(
    cls=_Commands,
    help="A multi-agent chemistry laboratory for reinforcement-learning research.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)


def _not_an_id(value: str) -> str:
    """Refuse the id of an environment where a scenario is meant."""
    if value.startswith("chemlab/") and ".toml" not in value:
        import gymnasium

        spec = gymnasium.registry.get(value)
        own = spec.kwargs.get("scenario") if spec is not None else None
        give = own or "a scenario, such as wurtz_dodecane (`chemlab list` names all)"
        raise ValueError(f"scenario: {value} is an environment's id; give {give}")
    return value


ScenarioArgument = Annotated[
    str,
    typer.Argument(callback=_not_an_id, help="A bundled scenario (see `chemlab list`) or a path to a TOML file."),
]


def current_policy(value: str) -> str:
    """Replace former names in the value of an option (see :func:`chemlab.agents.former_names.current_name`)."""
    from ..agents.former_names import current_name

    current: str = current_name(value)
    return current


PolicyOption = Annotated[
    str,
    typer.Option(
        callback=current_policy,
        help="The policy: scripted, scripted:unsafe, scripted:no-extraction, random, pretrained (benches), trained "
        "(manager and benches), plan (an open-loop manager), or the path of a training run; :greedy or :sampled after "
        "a learned one; exceptions by role or agent after commas: pretrained,manager=random.",
    ),
]
EpisodesOption = Annotated[int, typer.Option(min=1, help="Number of episodes, with consecutive seeds.")]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of the first episode.")]
SplitOption = Annotated[
    str,
    typer.Option(help="Split of worlds with hidden parameters: train, validation, test, or private:SALT."),
]


def _trust(ctx: typer.Context, value: bool) -> bool:
    """Allow untrusted code for the duration of the command if the flag is given."""
    if value:
        ctx.with_resource(strangers_code(True))
    return value


TrustOption = Annotated[
    bool,
    typer.Option(
        "--trust",
        callback=_trust,
        help="Allow untrusted code: parts that a scenario names (module:Name, file.py:Name), "
        "checkpoints of other users' runs.",
    ),
]
ProcessesOption = Annotated[
    int | None,
    typer.Option(min=1, help="Number of concurrent jobs. Default: one per core."),
]
AddressOption = Annotated[
    str | None,
    typer.Option(
        help="Where jobs run: auto or HOST:PORT of a Ray cluster (extra ray), or slurm (extra slurm). Default: here."
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print only JSON on standard output.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]


@app.callback(invoke_without_command=True)
def _options(
    ctx: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
    traceback: Annotated[bool, typer.Option("--traceback", help="Show tracebacks of errors.")] = False,
) -> None:
    _shown["traceback"] = traceback
    # For every command, including those without --trust.
    ctx.with_resource(strangers_code(False))
    if version:
        typer.echo(__version__)
        raise typer.Exit


@contextmanager
def resumable(folder: Path | None) -> Iterator[None]:
    """Say after an interruption that the same command resumes, if a folder keeps finished parts."""
    try:
        yield
    except KeyboardInterrupt:
        kept = "nothing is kept; with --keep FOLDER the same command would resume"
        err.print("stopped; " + (kept if folder is None else f"the same command resumes from {plain(folder)}"))
        raise typer.Exit(130) from None


def prepare(scenario: str, quiet: bool, split: str = "train") -> tuple[Scenario, raw_env]:
    """Load the scenario, print its name, and build its laboratory."""
    from ..config.loading import load_scenario

    spec = load_scenario(scenario)
    if not quiet:
        page.print(f"[bold]{plain(spec.name)}[/bold]: {plain(spec.summary)}")
    from ..envs.aec import raw_env

    return spec, raw_env(spec, split=split)


def chosen_agents(agents: Sequence[str], wanted: Iterable[str], what: str) -> list[str]:
    """Agents by id (``rxn_0``), by kind (``rxn``) or ``all``, in their order.

    Args:
        agents: all there are.
        wanted: what was asked for.
        what: the option that it was asked with.

    Raises:
        ValueError: no agent has this name.
    """
    kinds = {agent: agent.rpartition("_")[0] for agent in agents}
    unknown = set(wanted) - set(kinds) - set(kinds.values()) - {"all"}
    if unknown:
        raise ValueError(f"{what}: no agent is called {', '.join(sorted(unknown))}; known: {', '.join(kinds)}, all")
    return [agent for agent, kind in kinds.items() if {agent, kind, "all"} & set(wanted)]


def _path_of(word: str) -> str:
    """Return the path in a policy's name."""
    from ..agents.former_names import split_way

    name: str = split_way(word.removeprefix("plan:"))[0]
    return name


def check_apart_from(path: Path, *read: str | Path) -> None:
    """Check that a result overwrites no file that a command reads, nor one that its scenario names.

    Args:
        path: path of the result.
        read: paths, or words with paths in them: scenarios and policies as given to a command.

    Raises:
        ValueError: it would overwrite one; the message names the file.
    """
    words = [word for one in read for word in ([str(one)] if isinstance(one, Path) else re.split("[,=]", one))]
    # A word without a suffix is a name, even if such a file exists.
    named = [file for word in words if (file := Path(split_level(_path_of(word))[0])).suffix]
    check_apart([path], [one for file in named for one in (files_of(file) if file.suffix == ".toml" else [file])])


def check_result(path: Path, force: bool, *read: str | Path) -> None:
    """Check that a result can be written, and overwrites nothing but, with ``force``, a file that the command does not
    read.

    Raises:
        ValueError: it cannot be written, or would overwrite a file (see :func:`check_apart_from`).
        OSError: the name is not possible.
    """
    check_apart_from(path, *read)
    check_target(path, force)


def report_result(
    found: dict[str, Any], show: Callable[[dict[str, Any]], None], as_json: bool, output: Path | None
) -> None:
    """Print a result as tables or as JSON, and write it to a file where one is given, even if printing fails."""
    try:
        if as_json:
            typer.echo(json.dumps(found))
        else:
            show(found)
    finally:
        if output is not None:
            write_json(output, found)
