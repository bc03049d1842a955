"""Loading models through transformers: what is on this machine first, quietly, safetensors only."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from scoup.base.errors import InputError

Loaded = TypeVar("Loaded")

OPEN_CLIP = "open_clip:"
"""Before the names of models of open_clip."""


def open_clip_names(text: str) -> tuple[str, str]:
    """Architecture and pretrained tag of ``open_clip:ARCHITECTURE/PRETRAINED``.

    Raises:
        InputError: one of them is missing.
    """
    architecture, _, pretrained = text.removeprefix(OPEN_CLIP).partition("/")
    if not architecture or not pretrained:
        raise InputError(
            f"{text!r}: write {OPEN_CLIP}ARCHITECTURE/PRETRAINED, "
            f"such as {OPEN_CLIP}ViT-B-16/laion2b_s34b_b88k"
        )
    return architecture, pretrained


def load_local_first(
    load: Callable[[dict[str, Any]], Loaded], model_id: str, revision: str | None = None
) -> Loaded:
    """``load(options)`` with what is on this machine; only if that fails, with the network too.

    The hub's client would wait half a minute for a network that is not there.

    Args:
        load: calls ``from_pretrained`` with the options it is given.
        model_id: a folder or hub id.
        revision: branch, tag or commit.
    """
    options: dict[str, Any] = {"revision": revision} if revision else {}
    with quiet():
        try:
            return load({**options, "local_files_only": True})
        except Exception:
            if os.path.exists(model_id):
                raise
            return load(options)


@contextmanager
def quiet() -> Iterator[None]:
    """No reports, retries and progress bars of transformers and its hub; errors are raised, not printed."""
    from huggingface_hub.utils import logging as hub_logging
    from transformers.utils import logging

    verbosity, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    hub_verbosity = hub_logging.get_verbosity()
    logging.set_verbosity_error()  # it would list the weights of the towers that are not wanted
    logging.disable_progress_bar()
    hub_logging.set_verbosity_error()
    try:
        yield
    finally:
        logging.set_verbosity(verbosity)
        hub_logging.set_verbosity(hub_verbosity)
        if bars:
            logging.enable_progress_bar()


def first_line(error: BaseException) -> str:
    """The first line of an error's text, shortened; its kind where it has none."""
    lines = str(error).strip().splitlines()
    return lines[0][:160] if lines else type(error).__name__
