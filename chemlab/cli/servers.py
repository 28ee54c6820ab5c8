"""Commands that open a laboratory to other programs and to browsers: mcp, serve."""

from __future__ import annotations

import os
import secrets
import signal
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from ..config.extras import needs
from .options import ScenarioArgument, SeedOption, SplitOption, TrustOption, app, chosen_agents, prepare
from .screen import err, out, plain


@app.command()
def mcp(
    scenario: ScenarioArgument,
    seat: Annotated[
        list[str] | None,
        typer.Option(help="An agent (manager_0), a kind (rxn) or all; repeatable. Default: manager_0."),
    ] = None,
    http: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            help="Serve over HTTP on this port (0: a free one). Default: standard input and output.",
        ),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    background: Annotated[str, typer.Option(help="Policy of the agents without a seat.")] = "scripted",
    names: Annotated[str, typer.Option(help="Names of materials: plain, or opaque (permuted codes).")] = "plain",
    calls: Annotated[
        int | None, typer.Option(help="Maximum number of calls of a seat; one more truncates the episode.")
    ] = None,
    say: Annotated[int, typer.Option(help="Characters that a seat may send to the other seats.")] = 0,
    episode: Annotated[
        int | None,
        typer.Option(min=0, help="Play this episode of the benchmark, with its seed; needs CHEMLAB_SALT."),
    ] = None,
    token: Annotated[
        str | None,
        typer.Option(
            envvar="CHEMLAB_TOKEN", help="Token of the only seat over HTTP. Default: a fresh one for each seat."
        ),
    ] = None,
    out_folder: Annotated[
        Path | None,
        typer.Option("--out", help="Folder of records, transcripts and the ledger. Records are written at the end."),
    ] = None,
    trust: TrustOption = False,
) -> None:
    """Serve seats of a laboratory to language agents by the Model Context Protocol (needs the extra `mcp`).

    The environment variable CHEMLAB_SALT sets the salt of the private split. Without it, a salt is drawn, and
    published at the end.
    """
    salt = _taken_salt()
    from ..agents.evaluate.jobs import AUDIT_SEED
    from ..agents.seats import Room
    from ..config.loading import load_scenario

    with needs("seats over MCP need mcp", "mcp"):
        import anyio

        from ..agents import mcp_server
    spec = load_scenario(scenario)
    seats = chosen_agents(spec.agents(), seat or ["manager_0"], "--seat")
    if http is None and len(seats) > 1:
        raise ValueError(f"--seat: standard input and output serve one seat, given {len(seats)}; add --http PORT")
    if token is not None and (http is None or len(seats) > 1):
        raise ValueError("--token: is that of one seat over HTTP; leave it out, and every seat gets one of its own")
    if episode is not None and salt is None:
        raise ValueError("--episode: needs a salt, so that its world stays secret; set CHEMLAB_SALT")
    seed = None if episode is None else AUDIT_SEED + episode
    room = Room(spec, seats, background, names, calls, say, 10.0, out_folder, "tools only", salt, seed)
    try:
        if http is None:
            _exit_on_signals(room.close)
            anyio.run(mcp_server.serve_stdio, room)
        else:
            port = _free_port(host, http, "--http")
            tokens = {one: token or secrets.token_urlsafe(24) for one in seats}
            for one, own in tokens.items():
                shown = "the given token" if token else own
                address = f"{_origin(host, port)}/{one}/mcp"
                out.print(plain(f"{one} {address} Authorization: Bearer {shown}"), soft_wrap=True)
            _interrupt_on_signals()
            mcp_server.http_server(room, tokens, host, port).run()
    finally:
        room.close()


def _taken_salt() -> str | None:
    """The salt that the variable CHEMLAB_SALT gives, or None.

    Programs of the same user can read the environment that a process was started with. Therefore the process starts
    anew without the variable, and reads the salt from a pipe.
    """
    given, pipe = os.environ.pop("CHEMLAB_SALT", None), os.environ.pop("CHEMLAB_SALT_PIPE", None)
    if given is not None and os.name == "posix":
        reading, writing = os.pipe()
        os.write(writing, given.encode())
        os.close(writing)
        os.set_inheritable(reading, True)
        os.environ["CHEMLAB_SALT_PIPE"] = str(reading)
        # The words of the first start: `-m` instead of the script would import modules from the current folder.
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    if pipe is None:
        return given
    with open(int(pipe), encoding="utf-8") as file:
        return file.read()


@app.command()
def serve(
    scenario: ScenarioArgument,
    policy: Annotated[
        list[str] | None,
        typer.Option(help="Policy of all agents whose seat is free. Two policies give two laboratories side by side."),
    ] = None,
    seed: SeedOption = 0,
    split: SplitOption = "train",
    speed: Annotated[int, typer.Option(help="Turns a second: 1, 2, 6, 15, 40 or 60.")] = 6,
    paused: Annotated[bool, typer.Option("--paused", help="Begin paused, until Run is pressed in the page.")] = False,
    host: Annotated[
        str, typer.Option(help="Address to listen on. Addresses that others can reach need tokens, which are printed.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0: a free one.")] = 8765,
    out_folder: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder of the records, each written when its episode or the server ends. Default: a temporary one.",
        ),
    ] = None,
    trust: TrustOption = False,
) -> None:
    """Watch and play a laboratory in a browser (needs the extra `live`).

    The printed address opens the spectators' page, which shows the true contents. The page of a seat shows only what
    its agent observes.
    """
    from ..agents.live import LOCAL, SPEEDS, Live, live_app, live_server

    spec, _ = prepare(scenario, quiet=False, split=split)
    policies = policy or ["scripted"]
    if len(policies) > 2:
        raise ValueError(f"--policy: at most two, side by side, given {len(policies)}")
    if speed not in SPEEDS:
        raise ValueError(f"--speed: must be one of {', '.join(map(str, SPEEDS))}, given {speed}")
    local = host in LOCAL
    port = _free_port(host, port)
    agents = spec.agents()
    tokens = None if local else {one: secrets.token_urlsafe(24) for one in ("watch", *agents)}
    _interrupt_on_signals()
    with tempfile.TemporaryDirectory() as folder:
        lives = [
            Live(spec, name, seed, split, (out_folder or Path(folder)) / str(i)) for i, name in enumerate(policies)
        ]
        hosts = LOCAL if local else ("*",)
        pages = {"watch": ""} | ({} if tokens is None else {agent: f"lab/0/seat/{agent}" for agent in agents})
        for name, page_path in pages.items():
            query = "" if tokens is None else f"?token={tokens[name]}"
            out.print(plain(f"{name}: {_origin(host, port)}/{page_path}{query}"), soft_wrap=True)
        live_server(live_app(lives, policies, tokens, hosts, paused, speed), host, port).run()


def _exit_on_signals(close: Callable[[], None]) -> None:
    """Call ``close`` on Ctrl-C and SIGTERM, and end at once: reading standard input cannot be interrupted."""

    def end(number: int, frame: object) -> None:
        try:
            close()
        except (OSError, ValueError) as error:
            err.print(plain(error))
        finally:
            os._exit(128 + number)

    for ending in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending, end)


def _interrupt_on_signals() -> None:
    """End on SIGTERM and SIGHUP (a closed terminal) as on Ctrl-C: records are written, temporary folders deleted."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    hangup = getattr(signal, "SIGHUP", None)  # Windows has none
    if hangup is not None and signal.getsignal(hangup) is signal.SIG_DFL:  # nohup ignores it
        signal.signal(hangup, lambda *_: signal.raise_signal(signal.SIGTERM))


def _free_port(host: str, port: int = 0, option: str = "--port") -> int:
    """Return ``port`` if a server can listen there; for 0, a free one.

    Raises:
        ValueError: the port is taken, or reserved for administrators; the host is no address of this machine.
    """
    import errno
    import socket

    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        if os.name == "posix":  # as servers do, so that a port of a server that has just ended is free
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            known = {errno.EADDRINUSE: "is taken", errno.EACCES: "is reserved for administrators"}
            if error.errno in known:
                raise ValueError(f"port {port} {known[error.errno]}; give another with {option}") from error
            reason = f"--host: cannot listen on {host}: {error.strerror}"
            raise ValueError(f"{reason}; give an address of this machine, such as 127.0.0.1 or 0.0.0.0") from error
        return int(probe.getsockname()[1])


def _origin(host: str, port: int) -> str:
    """Return the beginning of a URL that other computers can open.

    If the host stands for all addresses of this machine, its address in the network takes its place.
    """
    import socket

    if host in ("0.0.0.0", "::"):
        v6 = ":" in host
        with suppress(OSError), socket.socket(socket.AF_INET6 if v6 else socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(("2001:db8::1" if v6 else "192.0.2.1", 9))  # documentation's addresses; nothing is sent
            host = probe.getsockname()[0]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
