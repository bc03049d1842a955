"""One snapshot of all messages: tests compare with tests/messages.json, `pytest --write-messages` writes it again.

Run it without ``-n``. Entries of tests that ran are replaced; with whole files, entries of tests that are gone are
removed. Read the difference in review: it shows every message that users will see otherwise.
"""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest

from scoup.base import InputError

SNAPSHOT = Path(__file__).parent / "messages.json"
# Folders of pytest, in a message.
_FOLDER = re.compile(r"[^\s'\"(=]*/pytest-of-[^/\s]+/pytest-\d+/(?:popen-gw\d+/)?[^/:;,\s'\")]+")
_seen: Counter[str] = Counter()
_written: dict[str, list[str]] = {}


@contextmanager
def refuses(
    kind: type[Exception] | tuple[type[Exception], ...] = InputError,
) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """Expect an error of this kind with the message of the snapshot."""
    with pytest.raises(kind) as raised:
        yield raised
    check_message(str(raised.value))


@contextmanager
def warns(kind: type[Warning]) -> Iterator[pytest.WarningsRecorder]:
    """Expect warnings of this kind, with the messages of the snapshot."""
    with pytest.warns(kind) as caught:
        yield caught
    check_message("\n".join(str(each.message) for each in caught if issubclass(each.category, kind)))


def check_message(text: str) -> None:
    """Compare a message with the next one that the snapshot has of the test that runs."""
    test = os.environ["PYTEST_CURRENT_TEST"].rpartition(" (")[0]
    text = _FOLDER.sub("TMP", text)
    number = _seen[test]
    _seen[test] += 1
    if os.environ.get("SCOUP_WRITE_MESSAGES"):
        _written.setdefault(test, []).append(text)
        return
    expected = _snapshot().get(test, [])
    assert number < len(expected), f"not in {SNAPSHOT.name}; run pytest --write-messages: {text}"
    assert text == expected[number]


@cache
def _snapshot() -> dict[str, list[str]]:
    return json.loads(SNAPSHOT.read_text(encoding="utf-8")) if SNAPSHOT.exists() else {}


def write(ran: Collection[str], whole_files: bool) -> None:
    """Replace the entries of tests that ran; with whole files, remove those of tests that are gone."""
    files = {test.partition("::")[0] for test in ran} if whole_files else set()
    kept = {
        test: texts
        for test, texts in _snapshot().items()
        if test not in ran and test.partition("::")[0] not in files
    }
    text = json.dumps(dict(sorted({**kept, **_written}.items())), indent=1, ensure_ascii=False)
    SNAPSHOT.write_text(text + "\n", encoding="utf-8")
