"""The viewer's server: what it answers, and what it refuses."""

from __future__ import annotations

import io
import json
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import anyio
import numpy as np
import pytest
from PIL import Image

pytest.importorskip("starlette", reason="needs scoup[view]")
from starlette.testclient import TestClient
from view_samples import PAGE, WORDS, field_with_things, table, unpacked, viewed_field

from messages import check_message
from scoup.io import PlyTable
from scoup.view.guard import MOST_BYTES, Guard, is_loopback
from scoup.view.server import application
from scoup.view.viewed_field import ViewedField
from scoup.view.work import MOST_WAITING, BusyError, SupersededError, Work

LOCAL = "http://127.0.0.1:8350"


@pytest.fixture(scope="module")
def viewed() -> ViewedField:
    return viewed_field(count=80)


def client_of(viewed: ViewedField, **options: Any) -> TestClient:
    return TestClient(
        application(viewed, PAGE, Guard.of("127.0.0.1"), **options), LOCAL, raise_server_exceptions=False
    )


@pytest.fixture(scope="module")
def client(viewed: ViewedField) -> TestClient:
    return client_of(viewed)


def parts_of(monkeypatch: pytest.MonkeyPatch) -> ViewedField:
    """A scene in two parts."""
    monkeypatch.setattr("scoup.view.parts.COARSE_GAUSSIANS", 10)
    monkeypatch.setattr("scoup.view.parts.PART_GAUSSIANS", 40)
    return viewed_field(count=80)


def test_the_page_gets_its_settings_and_its_files(client: TestClient, viewed: ViewedField) -> None:
    index = client.get("/")
    settings = json.loads(index.text.split('type="application/json">')[1].split("</script>")[0])
    assert settings["open"] == "scoup view field.scoup"
    for coding in ("gzip", "identity"):
        program = client.get("/viewer.js", headers={"accept-encoding": coding})
        assert program.content == PAGE.program
        assert program.headers.get("content-encoding", "identity") == coding
    assert client.get("/licences.txt").text == PAGE.licences
    for name, value in (("x-content-type-options", "nosniff"), ("referrer-policy", "no-referrer")):
        assert index.headers[name] == value
    assert "default-src 'none'" in index.headers["content-security-policy"]


def test_a_large_scene_comes_in_parts_packed_once_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    viewed, packed = parts_of(monkeypatch), []
    part = viewed.part

    def counted(number: int, whole: bool) -> bytes:
        packed.append(number)
        return part(number, whole=whole)

    monkeypatch.setattr(viewed, "part", counted)
    client = client_of(viewed)
    for number in (1, 0, 1, 0):
        data = client.get(f"/part/{number}-of-2")
        assert data.content == part(number)
        assert int(data.headers["content-length"]) == len(data.content)
        assert data.headers["x-scoup-field"] == viewed.identity
    assert packed == [1, 0]
    for wrong in ("2-of-2", "0-of-3", "-1-of-2", "x-of-2", f"{'1' * 5000}-of-2", "0"):
        assert client.get(f"/part/{wrong}").status_code == 404


def test_merged_parts_are_sent_whole_too(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = parts_of(monkeypatch)
    merged = ViewedField(whole.field.with_encoder(table()), most=40)
    scenes = [unpacked(scene)[1] for scene in (whole.scene(), merged.scene(exported=True), merged.scene())]
    assert [scene.get("most") for scene in scenes] == [None, None, 40]
    # One part at a time is kept.
    monkeypatch.setattr("scoup.view.server._MOST_PACKED", len(whole.part(1)) + 600)
    client = client_of(merged)
    for number, end, wanted in (
        (1, "?whole", whole),
        (1, "", merged),
        (0, "?whole", whole),
        (1, "?whole", whole),
    ):
        assert client.get(f"/part/{number}-of-2{end}").content == wanted.part(number)
    counts = [len(unpacked(each.part(0))[0]["opacities"]) for each in (merged, whole)]
    assert counts[0] <= 20 < counts[1] == 40


def test_the_scene_and_the_answers_fit_together(client: TestClient, viewed: ViewedField, monkeypatch) -> None:
    data = client.get("/scene.bin")
    assert int(data.headers["content-length"]) == len(data.content)
    metadata = unpacked(data.content)[1]
    # The server's metadata are those of the scene but for what the packing adds.
    assert client.get("/api/scene").json().items() <= metadata.items()
    answers = client.post("/api/query", json={"texts": ["thing 1", "thing 2"]}).json()["answers"]
    assert answers == [answer.to_dict() for answer in viewed.answers(["thing 1", "thing 2"])]
    assert client.get("/api/vocabulary").json() == {"names": list(WORDS), "closed": True}
    packed = threading.Event()
    monkeypatch.setattr(viewed, "scene", packed.set)
    client_of(viewed)
    assert packed.wait(60)  # at once, before anybody asks


def test_pictures_points_and_selections(client: TestClient, viewed: ViewedField, tmp_path: Path) -> None:
    camera = viewed.field.camera(0)
    record = viewed.metadata()["cameras"][0]
    asked = {"texts": ["thing 3", "thing 5"], "colors": [[64, 184, 245], [245, 158, 18]], "opacity": 0.7}
    for mode in ("color", "heat", "mask", "codes"):
        answer = client.post("/api/render", json={"camera": record, "mode": mode, **asked, "quality": 95})
        shown = np.asarray(Image.open(io.BytesIO(answer.content)).convert("RGB")).astype(int)
        wanted = viewed.picture(camera, mode, **asked).astype(int)  # pyright: ignore[reportArgumentType]
        assert np.abs(shown - wanted).mean() < 8
    found = client.post("/api/point", json={"camera": record, "pixel": [20.7, 15.2]}).json()
    assert found == json.loads(json.dumps(viewed.what_is_at(camera, (20, 15))))
    ply = client.post("/api/select", json={"texts": ["thing 3"], "always": True})
    assert ply.content.startswith(b"ply\n")
    assert 'filename="thing_3.ply"' in ply.headers["content-disposition"]
    assert f"element vertex {len(viewed.selection(['thing 3'], always=True))}\n".encode() in ply.content
    thumbnail = client.get("/api/thumbnail/2")
    assert Image.open(io.BytesIO(thumbnail.content)).size == (160, 120)
    # Things are saved with names in any script.
    client, path = client_of(ViewedField(field_with_things().with_encoder(table()))), tmp_path / "a.ply"
    names = {1: "tasse à café", 3: "杯子"}
    things = [{"number": number, "name": name} for number, name in names.items()]
    path.write_bytes(client.post("/api/select", json={"things": things}).content)
    assert PlyTable.read(path).comments[-2:] == tuple(f"thing {n}: {name}" for n, name in names.items())


CAMERA = {
    "viewmat": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "K": [9, 0, 4, 0, 9, 4, 0, 0, 1],
    "width": 8, "height": 8,
}  # fmt: skip
WRONG: list[tuple[str, dict[str, Any]]] = [
    *(("query", {"texts": texts}) for texts in ([], ["a"] * 9, "kettle", [7], ["x" * 201])),
    *(("query", {"texts": texts}) for texts in (["thing 1 or \ud800"], ["thing 99"])),
    ("query", {"texts": ["thing 1"], "always": 1}), ("select", {"things": [{"number": 1, "name": "\ud800"}]}),
    *(("select", {"texts": ["thing 1"], "level": level}) for level in (2, True)),
    *(("select", {"texts": ["thing 1"], "threshold": threshold}) for threshold in (1.5, "half")),
    ("point", {"camera": None}), ("render", {}), ("render", {"camera": CAMERA, "texts": ["thing 1"]}),
    *(("render", {"camera": CAMERA, "colors": colors}) for colors in ([[1, 2]], [[1, 2, 256]], 7)),
    ("render", {"camera": CAMERA, "opacity": None}), ("render", {"camera": {"viewmat": [0] * 15}}),
    ("render", {"camera": {"viewmat": [0] * 16, "K": ["1"] * 9}}),
    *(("render", {"camera": CAMERA | {"viewmat": [number] * 16}}) for number in (0.0, 1e300)),
    ("render", {"camera": CAMERA | {"K": [0.0] * 9}}),
    *(("render", {"camera": CAMERA | {"width": width}}) for width in (0, 10.5)),
    ("render", {"camera": CAMERA | {"height": 5000}}),
]  # fmt: skip


def test_wrong_messages_get_one_sentence(client: TestClient, viewed: ViewedField) -> None:
    for path, message in WRONG:
        answer = client.post(f"/api/{path}", content=json.dumps(message))
        assert answer.status_code == 400, message
        check_message(answer.json()["error"])
    for body in (b"", b"[]", b"\xff", b"[" * 60_000, b'{"texts": NaN'):
        answer = client.post("/api/query", content=body)
        assert (answer.status_code, answer.json()["error"]) == (400, "a message is one JSON object")

    class Broken(ViewedField):  # a fault of the program
        def answers(self, *texts: Any, **options: Any) -> Any:
            raise RuntimeError("secret")

    answer = client_of(Broken(viewed.field, None)).post("/api/query", json={"texts": ["thing 1"]})
    assert answer.status_code == 500
    assert "secret" not in answer.text
    assert "RuntimeError" in answer.json()["error"]


def sent(viewed: ViewedField, length: int, receive: Callable[[], Any]) -> list[Any]:
    """What a visitor gets whose message has so many bytes by its header."""
    headers = [(b"host", b"127.0.0.1:8350"), (b"content-length", str(length).encode())]
    scope = {
        "type": "http", "method": "POST", "path": "/api/query", "raw_path": b"/api/query", "root_path": "",
        "query_string": b"", "headers": headers, "scheme": "http", "server": ("127.0.0.1", 8350),
    }  # fmt: skip
    answers: list[Any] = []

    async def send(message: Any) -> None:
        answers.append(message)

    anyio.run(application(viewed, PAGE, Guard.of("127.0.0.1")), scope, receive, send)
    return answers


def test_names_out_of_files_in_another_encoding(
    client: TestClient, viewed: ViewedField, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {"name": "\udcff.scoup", "number": None}
    monkeypatch.setattr(viewed, "metadata", lambda: {**names, "number": float("nan")})
    assert client.get("/api/scene").json() == names


def test_messages_may_be_giant_or_end_in_their_midst(client: TestClient, viewed: ViewedField) -> None:
    without_length = iter([b" " * 40_000] * 3)
    for content in (b" " * (MOST_BYTES + 1), without_length):
        assert client.post("/api/query", content=content).status_code == 413
    assert sent(viewed, 99 * 10**9, anyio.sleep_forever)[0]["status"] == 413  # only announced
    part = {"type": "http.request", "body": b'{"texts": [', "more_body": True}
    parts = iter([part, {"type": "http.disconnect"}])

    async def receive() -> Any:
        return next(parts)

    sent(viewed, 30, receive)  # what is raised here would be a traceback on the terminal
    assert next(parts, None) is None


def test_other_sites_are_refused(client: TestClient) -> None:
    asked = {"texts": ["thing 1"]}
    origins = ["http://evil.example", "null", "http://[", "https://127.0.0.1:8351", "file://127.0.0.1:8350"]
    # Nobody reaches loopback by the name of this machine in its network.
    hosts = "evil.example evil.example:8350 127.0.0.1@evil.example 127.0.0.1.evil.example 192.168.1.7:8350"
    for headers in (
        *({"origin": origin} for origin in origins), *({"host": host} for host in (*hosts.split(), "")),
        {"sec-fetch-site": "cross-site"}, {"sec-fetch-site": "same-site"},  # another port of this machine
    ):  # fmt: skip
        answer = client.post("/api/query", json=asked, headers=headers)
        assert (answer.status_code, list(answer.json())) == (403, ["error"]), headers
    for headers in ({"origin": LOCAL}, {"host": "localhost:8350", "origin": "http://localhost:8350"}, {}):
        assert client.post("/api/query", json=asked, headers=headers).status_code == 200, headers
    assert client.get("/scene.bin", headers={"host": "evil.example"}).status_code == 403


def test_beyond_loopback_the_token_is_part_of_every_path(viewed: ViewedField) -> None:
    guard, other = Guard.of("0.0.0.0"), Guard.of("0.0.0.0")
    assert len(guard.token) >= 32
    assert guard.token != other.token
    client = TestClient(application(viewed, PAGE, guard), "http://192.168.1.7:8350")
    for name in ("", "viewer.js"):
        assert client.get(f"/{guard.token}/{name}").status_code == 200
    for prefix in ("", "/wrong", f"/{other.token}", f"/{guard.token[:-1]}", f"/{guard.token}x"):
        assert client.get(f"{prefix}/scene.bin").status_code == 404
        assert client.post(f"{prefix}/api/query", json={"texts": ["thing 1"]}).status_code == 404
    assert client.get(f"/{guard.token}/", headers={"host": "evil.example"}).status_code == 403
    assert all(map(is_loopback, ("localhost", "127.0.0.9", "::1")))
    assert not any(map(is_loopback, ("0.0.0.0", "a.example")))


@pytest.mark.parametrize(("visitors", "refused", "error"), [
    ("abaa", {0, 2}, SupersededError),  # a newer picture takes the place of those that wait
    ([str(number) for number in range(MOST_WAITING + 3)], set(range(MOST_WAITING, MOST_WAITING + 3)), BusyError),
], ids=["newer", "too many"])  # fmt: skip
def test_who_waits_for_nothing_is_told(visitors: Sequence[str], refused: set[int], error: type) -> None:
    done: list[int] = []
    errors: dict[int, type] = {}

    async def ask(work: Work, number: int, visitor: str) -> None:
        try:
            await work.run_newest(visitor, lambda: done.append(number))
        except (SupersededError, BusyError) as raised:
            errors[number] = type(raised)

    async def everything() -> None:
        work, gate = Work(), threading.Event()
        async with anyio.create_task_group() as group:
            group.start_soon(work.run, gate.wait)
            await anyio.wait_all_tasks_blocked()
            for number, visitor in enumerate(visitors):
                group.start_soon(ask, work, number, visitor)
                await anyio.wait_all_tasks_blocked()
            gate.set()

    anyio.run(everything)
    assert errors == dict.fromkeys(refused, error)
    assert done == [number for number in range(len(visitors)) if number not in refused]
