"""The real MCP client at the seats of one room, over standard input and output and over HTTP."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from callers import SALT, SEATS, SEED, played, serving

import chemlab
from chemlab.agents.ledger import read_ledger
from chemlab.agents.seats import Room

mcp = pytest.importorskip("mcp", reason="needs mcp (extra mcp)")
import anyio  # noqa: E402 - comes with it
import httpx2  # noqa: E402
from mcp.client import Client  # noqa: E402
from mcp.client.stdio import StdioServerParameters, stdio_client  # noqa: E402
from mcp.client.streamable_http import streamable_http_client  # noqa: E402

SERVER = """
import sys
import anyio
from chemlab.agents.mcp_server import serve_stdio
from chemlab.agents.seats import Room
room = Room("unlabelled", ("manager_0",), folder=sys.argv[1], salt="{salt}", seed={seed})
anyio.run(serve_stdio, room)
room.close()
"""


def text_of(result: Any) -> str:
    return str(result.content[0].text)


def test_over_standard_input_and_output(tmp_path: Path) -> None:
    calls, record = played(("manager_0",), tmp_path / "here")
    script = tmp_path / "server.py"
    script.write_text(SERVER.format(salt=SALT, seed=SEED))
    given: Any = {"args": [str(script), str(tmp_path / "there")], "env": dict(os.environ), "cwd": str(tmp_path)}
    server = StdioServerParameters(command=sys.executable, **given)

    async def play() -> list[str]:
        async with Client(stdio_client(server)) as client:
            assert "manager_0 in a simulated" in (client.instructions or "")
            tools = {tool.name: tool for tool in (await client.list_tools()).tools}
            assert {"start", "measure", "submit", "look", "wait"} <= set(tools)
            assert tools["measure"].input_schema["properties"]["instrument"]["enum"] == ["uv_vis", "gas_chromatograph"]
            wrong = await client.call_tool("measure", {"slot": 77, "instrument": "uv_vis"})
            assert wrong.is_error
            assert "slot must be one of 0, 1," in text_of(wrong)
            assert (await client.call_tool("reset", {})).is_error
            await client.call_tool("look", {})
            return [text_of(await client.call_tool(verb, given)) for _, verb, given in calls]

    assert "The episode is over (submitted)" in anyio.run(play)[-1]
    assert (tmp_path / "there" / "episode-0000.jsonl").read_bytes() == record


def test_two_seats_over_http(tmp_path: Path) -> None:
    calls, record = played(SEATS, tmp_path / "here")
    room = Room("unlabelled", SEATS, folder=tmp_path / "there", salt=SALT, seed=SEED)
    tokens = {"manager_0": "token-of-the-manager", "dit_0": "token-of-dit"}

    def at(port: int, seat: str, token: str) -> Any:
        http = httpx2.AsyncClient(headers={"Authorization": f"Bearer {token}"}, timeout=60)
        return Client(streamable_http_client(f"http://127.0.0.1:{port}/{seat}/mcp", http_client=http))

    async def play(port: int) -> str:
        for token in ("none", "token-of-dit"):
            async with httpx2.AsyncClient(headers={"Authorization": f"Bearer {token}"}) as http:
                answer = await http.post(f"http://127.0.0.1:{port}/manager_0/mcp", json={})
                assert answer.status_code == 401
        async with at(port, "manager_0", tokens["manager_0"]) as manager, at(port, "dit_0", tokens["dit_0"]) as still:
            clients, text = {"manager_0": manager, "dit_0": still}, ""
            assert "manager_0 has the turn" in text_of(await still.call_tool("wait", {}))
            for agent, verb, given in calls:
                await clients[agent].call_tool("look", {})
                text = text_of(await clients[agent].call_tool(verb, given))
            return text

    from chemlab.agents.mcp_server import http_server

    with serving(http_server(room, tokens, "127.0.0.1", 0)) as port:
        assert "The episode is over" in anyio.run(play, port)
    assert (tmp_path / "there" / "episode-0000.jsonl").read_bytes() == record


@pytest.mark.parametrize("http", [False, True])
@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_episode_and_keeps_it(http: bool, ending: signal.Signals, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "chemlab", "mcp", "unlabelled", "--out", str(tmp_path), *["--http", "0"] * http]
    process: Any = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    if http:
        address = process.stdout.readline().decode().split()[1]
        for _ in range(100):
            with contextlib.suppress(httpx2.HTTPError):
                httpx2.get(address)
                break
            time.sleep(0.1)
    else:
        process.stdin.write(json.dumps({"jsonrpc": "2.0", "id": 1, "method": "ping"}).encode() + b"\n")
        process.stdin.flush()
        process.stdout.readline()
    process.send_signal(ending)
    process.wait(30)
    process.stdin.close()
    process.stdout.close()
    assert read_ledger(tmp_path / "ledger.jsonl")[-1]["event"] == "ended"
    assert (tmp_path / "episode-0000.jsonl.part").exists()


@pytest.mark.parametrize("given", [False, True])
def test_the_command_keeps_its_secrets(given: bool, tmp_path: Path) -> None:
    """While it runs no file, argument or environment variable tells the salt, a drawn seed or the world.

    Files are all that the server has written (its folder, home, temporary files, caches) or holds open. A given salt is
    that of several episodes: nor do the files of one that is over.
    """
    out, began = tmp_path / "out", time.time()
    command = [sys.executable, "-m", "chemlab", "mcp", "unlabelled", "--seat", "manager_0", "--out", str(out)]
    environment = {name: value for name, value in os.environ.items() if name != "CHEMLAB_SALT"}
    caches = [Path(environment.setdefault("NUMBA_CACHE_DIR", str(Path.home() / ".cache" / "chemlab")))]
    caches += [place for root in chemlab.__path__ for place in Path(root).rglob("__pycache__")]
    for name in ("HOME", "TMPDIR", "XDG_CACHE_HOME", "CHEMLAB_STATE_DIR"):
        (tmp_path / name).mkdir()
        environment[name] = str(tmp_path / name)
    if given:
        Room("unlabelled", folder=out, salt=SALT, seed=SEED).close()
        command += ["--episode", "3"]
        environment["CHEMLAB_SALT"] = SALT
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    process: Any = subprocess.Popen(command, env=environment, cwd=tmp_path / "HOME", **pipes)

    def send(method: str, params: dict[str, Any], **number: int) -> None:
        message = {"jsonrpc": "2.0", "method": method, "params": params, **number}
        process.stdin.write(json.dumps(message).encode() + b"\n")
        process.stdin.flush()

    client = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "t", "version": "0"}}
    send("initialize", client, id=1)
    assert json.loads(process.stdout.readline())["id"] == 1  # nothing else is on standard output
    send("notifications/initialized", {})
    send("tools/call", {"name": "start", "arguments": {"bench": "rxn_0", "slot": 0, "goal": "dodecane"}}, id=2)
    assert "vessel at rxn_0" in process.stdout.readline().decode()
    proc = Path(f"/proc/{process.pid}")
    files = {path for path in tmp_path.rglob("*") if path.is_file()}
    files |= {path for place in caches for path in place.rglob("*") if path.is_file() and path.stat().st_mtime >= began}
    files |= {path.resolve() for path in proc.glob("fd/*") if path.resolve().is_file()}
    seen = b"".join(
        path.read_bytes() for path in [*sorted(files), *map(proc.joinpath, ("cmdline", "environ"))] if path.exists()
    )
    process.stdin.close()
    process.wait(60)
    process.stdout.close()
    over = {"episode-0000.jsonl.part", "episode-0000.transcript.jsonl"}
    assert {path.name for path in files if out in path.parents} - over == {"ledger.jsonl"}
    ended = read_ledger(out / "ledger.jsonl")[-1]
    assert (ended["status"], ended["condition"]) == ("given up", "tools only")
    salt = SALT if given else ended["split"].partition(":")[2]
    world = Room("unlabelled", salt=salt, seed=ended["seed"]).laboratories.worlds
    secrets = [salt, *(f"{value:.9f}"[:8] for value in world.values(0)["titre"].values())]
    secrets += [] if given else [str(ended["seed"]), str(world.number(0))]
    assert len(secrets) > 2
    assert [secret for secret in secrets if secret.encode() in seen] == []
