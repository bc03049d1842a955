"""Viewers: a real server of a field, its address and its end."""

from __future__ import annotations

import json
import socket
import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("uvicorn", reason="needs scoup[view]")

from view_samples import PAGE, random_field, table, viewed_field

from messages import refuses
from scoup.base.errors import InputError, ScoupError
from scoup.view import viewer as module
from scoup.view.viewer import PORT, Viewer, check_needed, open_viewer


@pytest.fixture(autouse=True)
def page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "page_files", lambda: PAGE)


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    with Viewer(viewed_field(), port=0) as opened:
        yield opened


def ask(viewer: Viewer, path: str, message: Any) -> Any:
    body = json.dumps(message).encode()
    request = urllib.request.Request(f"{viewer.address}{path}", body)
    with urllib.request.urlopen(request) as answer:
        return json.load(answer)


def test_it_answers_until_it_is_closed(viewer: Viewer) -> None:
    assert viewer.is_open
    assert repr(viewer) == f"Viewer(field at {viewer.address})"
    assert f'src="{viewer.address}"' in viewer._repr_html_()
    assert ask(viewer, "api/query", {"texts": ["thing 1"]})["answers"][0]["text"] == "thing 1"
    viewer.close()
    assert not viewer.is_open
    assert "closed" in viewer._repr_html_()
    with pytest.raises(urllib.error.URLError):
        ask(viewer, "api/query", {"texts": ["thing 1"]})
    viewer.close()  # once more does nothing


def test_a_port_in_use_is_named_or_another_is_taken() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=rf"port {port}: .*in use.*another `port`"):
            Viewer(viewed_field(), port=port)
    with Viewer(viewed_field()) as first, Viewer(viewed_field()) as second:
        assert first.address != second.address
        assert first.address.startswith("http://127.0.0.1:")
    assert PORT > 1024
    for host in ("192.0.2.1", "no such host"):
        with pytest.raises(InputError, match=r"is not a host|[Cc]annot assign"):
            Viewer(viewed_field(), host=host, port=0)


def test_a_field_opens_its_viewer() -> None:
    with open_viewer(random_field().with_encoder(table()), words=["thing 3"], height=300) as viewer:
        assert 'height="300"' in viewer._repr_html_()
        with urllib.request.urlopen(f"{viewer.address}api/vocabulary") as answer:
            assert json.load(answer)["names"] == ["thing 3"]


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    check_needed()
    monkeypatch.setattr(module, "_NEEDED", ("uvicorn", "no_such_package"))
    with refuses(ScoupError):
        open_viewer(random_field())
