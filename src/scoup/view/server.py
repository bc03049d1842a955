"""The viewer's server: hands out the page and the field opened, answers questions, and nothing else."""

from __future__ import annotations

import asyncio
import json
import tempfile
from collections.abc import Awaitable, Callable, Hashable
from functools import partial
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.background import BackgroundTask
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.types import Message as AsgiMessage

from scoup.base import ScoupError, UnknownNameError, as_json
from scoup.field import Cache
from scoup.view.connections import PART
from scoup.view.export import jpeg
from scoup.view.guard import HEADERS, MOST_BYTES, Guard
from scoup.view.page import PageFiles
from scoup.view.requests import Message
from scoup.view.viewed_field import ViewedField
from scoup.view.work import BusyError, SupersededError, Work

Answer = Callable[[Message, str], Awaitable[Response]]
_MOST_PACKED = 64 << 20  # bytes of the cache: parts of a million Gaussians are packed once


def application(viewed: ViewedField, page: PageFiles, guard: Guard, remote: bool = False) -> ASGIApp:
    """Return the server of one field; a ``remote`` page shows pictures of this server only, and gets no Gaussians."""
    desk = _Answers(viewed, page, "remote" if remote else "live")
    routes = [
        Route("/", desk.index),
        Route("/viewer.js", desk.program),
        Route("/viewer.css", partial(_text, page.style, "text/css")),
        Route("/licences.txt", partial(_text, page.licences, "text/plain")),
        Route("/scene.bin", desk.scene),
        Route("/part/{number}-of-{count}", desk.part),
        Route("/api/scene", desk.metadata),
        Route("/api/vocabulary", desk.vocabulary),
        Route("/api/things", desk.things),
        Route("/api/thumbnail/{number}", desk.thumbnail),
        Route("/api/alive", desk.alive),
        *(
            Route(f"/api/{answer.__name__}", partial(_answered, answer), methods=["POST"])
            for answer in (desk.query, desk.render, desk.point, desk.select)
        ),
    ]
    inner = Starlette(routes=[Mount(guard.prefix, routes=routes)], exception_handlers=_HANDLERS)
    return _Guarded(inner, guard)


class _Answers:
    """The answer to each request. Work on the field goes through one thread."""

    def __init__(self, viewed: ViewedField, page: PageFiles, mode: str) -> None:
        self.viewed = viewed
        self.page = page
        self.mode = mode
        self.work = Work()
        self._cache = Cache(_MOST_PACKED)
        if mode != "remote":  # packed while a browser is opened
            self.work.begin(lambda: self._cache.value("scene", viewed.scene))

    async def _kept(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return a value made once for all visitors, while the cache has room for it."""
        value = self._cache.get(key)
        return await self.work.run(lambda: self._cache.value(key, make)) if value is None else value

    async def index(self, request: Request) -> Response:
        html = self.page.with_settings(self.viewed.settings(self.mode))
        return Response(html, media_type="text/html")

    async def program(self, request: Request) -> Response:
        if "gzip" not in request.headers.get("accept-encoding", ""):
            return Response(self.page.program, media_type="text/javascript")
        headers = {"content-encoding": "gzip", "vary": "accept-encoding"}
        return Response(self.page.packed_program, media_type="text/javascript", headers=headers)

    async def alive(self, request: Request) -> Response:
        return Response(status_code=204, headers={"x-scoup-field": self.viewed.identity})

    async def scene(self, request: Request) -> Response:
        data = await self._kept("scene", self.viewed.scene)
        return Response(data, media_type="application/octet-stream")

    async def part(self, request: Request) -> Response:
        parts = self.viewed.n_parts
        number = _number(request, parts)
        if request.path_params["count"] != str(parts):
            raise HTTPException(404)
        whole = "whole" in request.query_params
        data = await self._kept(("part", number, whole), lambda: self.viewed.part(number, whole=whole))
        headers = {"x-scoup-field": self.viewed.identity}
        return Response(data, media_type="application/octet-stream", headers=headers)

    async def metadata(self, request: Request) -> Response:
        return _json(await self.work.run(self.viewed.metadata))

    async def vocabulary(self, request: Request) -> Response:
        vocabulary = await self.work.run(self.viewed.vocabulary)
        names = [] if vocabulary is None else list(vocabulary.texts)
        return _json({"names": names, "closed": self.viewed.is_closed()})

    async def things(self, request: Request) -> Response:
        return _json({"things": await self._kept("things", self.viewed.things)})

    async def thumbnail(self, request: Request) -> Response:
        cameras = self.viewed.field.cameras or ()
        number = _number(request, len(cameras))
        picture = await self._kept(number, lambda: jpeg(self.viewed.thumbnail(cameras[number])))
        return Response(picture, media_type="image/jpeg")

    async def query(self, message: Message, visitor: str) -> Response:
        texts, always = message.texts(), message.flag("always")
        answers = await self.work.run(lambda: self.viewed.answers(texts, always))
        return _json({"answers": [answer.to_dict() for answer in answers]})

    async def render(self, message: Message, visitor: str) -> Response:
        mode: Any = message.fields.get("mode", "color")
        shown = message.texts(least=0), message.colors(), message.opacity()
        camera, rules, quality = message.camera(), self._rules(message), message.quality()
        picture = await self.work.run_newest(
            visitor, lambda: jpeg(self.viewed.picture(camera, mode, *shown, **rules), quality)
        )
        return Response(picture, media_type="image/jpeg")

    async def point(self, message: Message, visitor: str) -> Response:
        camera, pixel = message.camera(), message.pixel()
        return _json(await self.work.run(lambda: self.viewed.what_is_at(camera, pixel)))

    async def select(self, message: Message, visitor: str) -> Response:
        things, rest = message.things(), message.flag("rest")
        texts = [] if things else message.texts()
        rules = self._rules(message)
        folder = tempfile.TemporaryDirectory(prefix="scoup-view-")
        path = Path(folder.name) / "selection.ply"

        def write() -> None:
            if things:
                self.viewed.things_selection(things, rest).write(path)
            else:
                self.viewed.selection(texts, rest=rest, **rules).write(path)

        try:
            await self.work.run(write)
        except BaseException:
            folder.cleanup()
            raise
        name = "".join(letter if letter.isalnum() else "_" for letter in [*things.values(), *texts][0])
        name = f"without_{name}.ply" if rest else f"{name}.ply"
        return FileResponse(path, filename=name, background=BackgroundTask(folder.cleanup))

    def _rules(self, message: Message) -> dict[str, Any]:
        """Return the options by which texts are answered."""
        level = message.level(len(self.viewed.field.levels))
        return {"level": level, "threshold": message.threshold(), "always": message.flag("always")}


async def _text(content: Any, media_type: str, request: Request) -> Response:
    return Response(content, media_type=media_type)


def _number(request: Request, count: int) -> int:
    """Return the number in the path, which must be below the count."""
    digits = request.path_params["number"]
    # Not starlette's int: Python refuses to parse thousands of digits.
    number = int(digits) if digits.isascii() and digits.isdecimal() and len(digits) < 10 else count
    if number >= count:
        raise HTTPException(404)
    return number


async def _answered(answer: Answer, request: Request) -> Response:
    """Return the answer to a message that is JSON."""
    too_long = _error(413, f"a message has at most {MOST_BYTES:,} bytes")
    announced = request.headers.get("content-length", "0")
    if not announced.isdecimal() or int(announced) > MOST_BYTES:
        return too_long  # without waiting for it
    body = b""
    try:
        async for chunk in request.stream():
            body += chunk
            if len(body) > MOST_BYTES:
                return too_long
    except ClientDisconnect:  # the visitor has left
        return _error(400, "the message broke off")
    try:
        fields = json.loads(body)
    except (ValueError, RecursionError):
        fields = None
    if not isinstance(fields, dict):
        return _error(400, "a message is one JSON object")
    return await answer(Message(fields), request.headers.get("x-scoup-visitor", "")[:64])


class _Guarded:
    """Refuses what the guard refuses, and adds the headers that keep the page to itself."""

    def __init__(self, inner: ASGIApp, guard: Guard) -> None:
        self.inner = inner
        self.guard = guard

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.inner(scope, receive, send)
            return

        headers = Request(scope).headers
        names = headers.get("host"), headers.get("origin"), headers.get("sec-fetch-site")
        reason = self.guard.refuses(scope["method"], *names)
        # Without the token, a connection gets one answer.
        ends = reason is not None or not self.guard.has_token(scope)
        added = {**HEADERS, "connection": "close"} if ends else HEADERS

        async def send_with_headers(message: AsgiMessage) -> None:
            if message["type"] == "http.response.start":
                pairs = [(name.encode(), value.encode()) for name, value in added.items()]
                message = {**message, "headers": [*message.get("headers", []), *pairs]}
            body = message.get("body", b"")
            for start in range(PART, len(body), PART):  # a client has a deadline for each
                await send({**message, "body": body[start - PART : start], "more_body": True})
                await asyncio.sleep(0)  # let other tasks run
            await send({**message, "body": body[(len(body) - 1) // PART * PART :]} if body else message)

        if reason is not None:
            await _error(403, reason)(scope, receive, send_with_headers)
            return
        await self.inner(scope, receive, send_with_headers)


def _json(record: Any, status: int = 200) -> Response:
    return Response(as_json(record, indent=None), status, media_type="application/json")


def _error(status: int, sentence: str) -> Response:
    return _json({"error": sentence}, status)


def _refusal(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 404
    return _error(status, "there is nothing here; open the address that scoup view printed")


def _user_error(request: Request, error: Exception) -> Response:
    if isinstance(error, UnknownNameError):  # without the file that was searched
        error = UnknownNameError(error.kind, error.name, error.nearest)
    return _error(400, str(error))


def _fault(request: Request, error: Exception) -> Response:
    kind = type(error).__name__
    return _error(500, f"a fault of the program ({kind}); the terminal of scoup view says more")


_HANDLERS: dict[Any, Any] = {
    HTTPException: _refusal,
    ScoupError: _user_error,
    BusyError: lambda *_: _error(503, "the server is busy; try again in a moment"),
    SupersededError: lambda *_: _error(409, "a newer picture was asked for"),
    500: _fault,
}
