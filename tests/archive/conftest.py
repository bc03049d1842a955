"""Three rooms, and an archive of them."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import scoup
from query.planted_room import CLUTTER, ROOM, Box, planted_room
from scoup.models import WordTable
from scoup.query import LanguageField
from support import altered, table_of


@pytest.fixture(scope="session")
def fields(tmp_path_factory: pytest.TempPathFactory) -> dict[str, LanguageField]:
    """Saved fields of three rooms, of other things each: one has three mugs, one no mug and no laptop."""
    folder = tmp_path_factory.mktemp("fields")
    rooms = {
        "office": ROOM,
        "kitchen": (*ROOM, Box("mug", (-1, 0.7, 1.1), (0.2, 0.2, 0.2))),
        "hall": tuple(box for box in ROOM if box.name not in ("mug", "laptop")),
    }
    # Words of one table, as embeddings of one model have.
    encoder = planted_room().encoder
    assert encoder.names is not None
    WordTable.save(folder / "words.npz", encoder.names, encoder.encode(encoder.names).numpy())
    made = {}
    for name, room in rooms.items():
        planted = planted_room(room)
        names = [*(box.name for box in room), *CLUTTER]
        things = replace(table_of(planted), embeddings=encoder.encode(names).half())
        info = replace(planted.info, embedding_model="some/model", words=folder / "words.npz")
        made[name] = field = altered(planted, thing_table=things, info=info, words=encoder)
        field.save(folder / f"{name}.scoup")
    return made


@pytest.fixture(scope="session")
def archive_folder(fields: dict[str, LanguageField], tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = scoup.Archive(tmp_path_factory.mktemp("archive") / "sc[an]*s")
    for floor, field in enumerate(fields.values()):
        made.add(field, floor=floor, city="Graz")
    return made.folder


@pytest.fixture
def archive(archive_folder: Path, tmp_path: Path) -> scoup.Archive:
    """A copy of its own."""
    return scoup.Archive(shutil.copytree(archive_folder, tmp_path / archive_folder.name))
