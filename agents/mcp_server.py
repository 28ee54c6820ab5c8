"""Seats of a room as an MCP server: one over standard input and output, several over HTTP with a token each."""

import hmac
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import mcp_types as types
import uvicorn
from anyio.to_thread import run_sync
from mcp.server.lowlevel import Server
from mcp.server.stdio import stdio_server
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Mount

from .seats import Room

__all__ = ["http_server", "seat_server", "serve_stdio"]


def seat_server(room: Room, agent: str) -> Server[Any]:
    """An MCP server of one seat, whose tools are the seat's verbs."""

    async def listed(context: Any, given: Any) -> types.ListToolsResult:
        return types.ListToolsResult(tools=[types.Tool(**tool) for tool in room.tools(agent)])

    async def called(context: Any, given: Any) -> types.CallToolResult:
        reply = await run_sync(room.call, agent, given.name, given.arguments)
        return types.CallToolResult(content=[types.TextContent(type="text", text=reply.text)], is_error=reply.error)

    return Server("chemlab", instructions=room.brief(agent), on_list_tools=listed, on_call_tool=called)


async def serve_stdio(room: Room) -> None:
    """Serve the room's only seat over standard input and output, until the input ends."""
    server = seat_server(room, room.seats[0])
    async with stdio_server() as (reading, writing):
        await server.run(reading, writing, server.create_initialization_options())


def http_server(room: Room, tokens: Mapping[str, str], host: str, port: int) -> uvicorn.Server:
    """A server of all seats under ``/SEAT/mcp``; a request needs its seat's token as ``Authorization: Bearer TOKEN``.

    Idle connections stay open, because an agent may think for minutes between two calls.
    """
    options: dict[str, Any] = {"stateless_http": True, "json_response": True, "host": host}
    apps = {seat: seat_server(room, seat).streamable_http_app(**options) for seat in room.seats}

    def guarded(seat: str) -> Any:
        async def check(scope: Any, receive: Any, send: Any) -> None:
            given = dict(scope.get("headers", ())).get(b"authorization", b"")
            known = hmac.compare_digest(given, f"Bearer {tokens[seat]}".encode())
            answer = apps[seat] if known else PlainTextResponse(f"{seat}: wrong or missing token", 401)
            await answer(scope, receive, send)

        return check

    @asynccontextmanager
    async def lifespan(app: Any) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            for own in apps.values():
                await stack.enter_async_context(own.router.lifespan_context(own))
            yield
        room.close()  # here, because a signal that has ended the server ends the process after it

    app = Starlette(routes=[Mount(f"/{seat}", guarded(seat)) for seat in room.seats], lifespan=lifespan)
    # uvicorn's own setting of logging would close the handlers of the whole process.
    return uvicorn.Server(
        uvicorn.Config(app, host, port, log_config=None, log_level="warning", timeout_keep_alive=3600)
    )
