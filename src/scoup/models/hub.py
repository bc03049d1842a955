"""Models by name and revision, through transformers or open_clip: this machine's cache first, safetensors only."""

from __future__ import annotations

import difflib
import json
import os
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

import torch

from scoup.base import InputError, ScoupError, listed, refuse_pointer
from scoup.models.failures import reason_of
from scoup.models.normalization import PLAIN, Normalization

Loaded = TypeVar("Loaded")

OPEN_CLIP = "open_clip:"  # before the name of a model of open_clip
_READ = re.compile(r"[^.]*\.(safetensors|json|txt)")  # of a folder; "model.fp16.safetensors" is not
# A model of open_clip that brings its own description.
_OF_HUB = re.compile(r"hf-hub:[\w.-]+/[\w.-]+(@[\w.-]+)?")
# As its authors write ViT-B-16: ViT-B/16.
_SPELT = re.compile(r"^([\w-]*ViT-\w+)/(\d+)(?:@(\d+)px)?(?=[-/]|$)")
_SINCE = dict.fromkeys(("sam3", "sam3_tracker", "sam3_tracker_video", "sam3_video"), "5.0") | {
    "tipsv2": "5.14"
}
"""Types of models that the oldest transformers of pyproject.toml does not know -> the first that does."""
# Package -> its name in an index.
_DISTRIBUTIONS = {"transformers": "transformers", "open_clip": "open_clip_torch"}
# Seconds within which a hub that can be reached answers; its own client would try for a minute.
_PATIENCE = 5.0


@dataclass(frozen=True)
class ModelRequest:
    """A model to load, and the words for messages about it."""

    role: str  # "text model", "embedder" or "segmenter"
    name: str  # as the user wrote it
    alternative: str  # what works without the model, as an imperative
    model_id: str = ""  # a folder or hub id, where ``name`` is short for one
    revision: str | None = None  # branch, tag or commit of a hub model
    # how to bring the model here without a hub; "" for a folder that the hub's own tool makes
    by_hand: str = ""

    @property
    def source(self) -> str:
        return self.model_id or self.name

    def unusable(self, problem: str) -> ScoupError:
        """Return the error for a model that was found but cannot be used."""
        return ScoupError(f"{self.role} {self.name!r} cannot be loaded: {problem}")

    def unreachable(self, hub: str) -> ScoupError:
        """Return the error for a model that is not on this machine while no hub can be reached."""
        by_hand = self.by_hand or (
            f"run 'hf download {self.source} --local-dir FOLDER' elsewhere and pass FOLDER instead of the name"
        )
        return self.unusable(
            f"it is not, or not completely, on this machine, and {hub}; {by_hand}, or {self.alternative}"
        )

    def unreadable(self, cause: BaseException) -> ScoupError:
        """Return the error for a model whose files cannot be fetched or read."""
        if isinstance(cause, MemoryError) or "out of memory" in str(cause):
            raise cause
        return self.unusable(f"{reason_of(self.source, cause)}, or {self.alternative}")

    def package(self, name: str, extra: str) -> Any:
        """Import the package that loads the model; ScoupError where it is not installed."""
        try:
            return import_module(name)
        except ImportError as error:
            raise ScoupError(
                f"{self.role} {self.name!r} needs the package {name}: pip install 'scoup[{extra}]', "
                f"or {self.alternative}"
            ) from error


@dataclass(frozen=True)
class ModelIdentity:
    """Identity of a model, as far as it can be told without reading the weights."""

    name: str  # the hub id, or the last part of the folder
    revision: str  # the commit of a hub model; "" if unknown
    package: str  # that runs it, with its version
    files: tuple[str, ...] = ()  # of a model on this machine: path, size and times of change

    def is_current(self, name: str, revision: str | None) -> bool:
        """Return whether a name still opens this model, without opening it; False if that cannot be told."""
        package, _, version = self.package.partition(" ")
        if package not in _DISTRIBUTIONS:
            return False
        with suppress(metadata.PackageNotFoundError):  # without the package, no other version can be meant
            if metadata.version(_DISTRIBUTIONS[package]) != version:
                return False
        is_open_clip = name.startswith(OPEN_CLIP)
        if file_states(name.partition("/")[2] if is_open_clip else name) != self.files:
            return False
        if is_open_clip or self.files:
            return True
        return self.revision != "" and _cached_commit(name, revision) in ("", self.revision)


def _cached_commit(name: str, revision: str | None) -> str:
    """Return the commit of a branch or tag in this machine's cache of Hugging Face; "" if it is not there."""
    if find_spec("huggingface_hub") is None:
        return ""
    from huggingface_hub import constants

    folder = Path(constants.HF_HUB_CACHE, f"models--{name.replace('/', '--')}", "refs")
    try:
        return (folder / (revision or "main")).read_text(encoding="utf-8").strip()
    except (OSError, ValueError):
        return ""


def file_states(path: str) -> tuple[str, ...]:
    """Return path, size and times of change of a file, or of the files in a folder; nothing if it is not there."""
    files = sorted(entry.path for entry in os.scandir(path)) if os.path.isdir(path) else [path]
    states = [(file, os.stat(file)) for file in map(os.path.realpath, files) if os.path.isfile(file)]
    return tuple(f"{file} {state.st_size} {state.st_mtime_ns} {state.st_ctime_ns}" for file, state in states)


@dataclass(frozen=True, eq=False)
class Pretrained:
    """The files of one model, as transformers reads them."""

    transformers: Any  # the package
    model_id: str  # a folder or hub id
    options: dict[str, Any]  # for every ``from_pretrained``: revision, and whether to stay offline

    @cached_property
    def config(self) -> Any:
        try:
            # Code of a repository is never run, nor asked for on the terminal.
            options = {**self.options, "trust_remote_code": False}
            return self.transformers.AutoConfig.from_pretrained(self.model_id, **options)
        except ValueError as error:
            record, _ = self.transformers.PretrainedConfig.get_config_dict(self.model_id, **self.options)
            kind = record.get("model_type")
            if kind not in _SINCE:
                raise
            raise ScoupError(
                f"{kind} models need transformers {_SINCE[kind]} or newer (this is {self.transformers.__version__}); "
                "run 'pip install -U transformers'"
            ) from error

    @property
    def commit(self) -> str:
        """Return the commit of a hub model, or the requested revision; "" if unknown."""
        return getattr(self.config, "_commit_hash", None) or self.options.get("revision") or ""

    def identity(self) -> ModelIdentity:
        """Return the identity of the model."""
        package = f"transformers {self.transformers.__version__}"
        if os.path.isdir(self.model_id):
            name = os.path.basename(os.path.realpath(self.model_id))
            return ModelIdentity(name, "", package, file_states(self.model_id))
        return ModelIdentity(self.model_id, self.commit, package)

    def tokenizer(self) -> Any:
        return self.transformers.AutoTokenizer.from_pretrained(self.model_id, **self.options)

    def model(self, kind: Any, **options: Any) -> Any:
        """Load a model class of transformers in evaluation mode, on the CPU, in 32 bits.

        Files of 16 bits too: in these a CPU is slower, and transformers 5 would keep them.
        A file that lacks weights raises ScoupError: transformers would invent them.
        """
        # Safetensors only: loading a pickled checkpoint runs whatever it contains.
        model, loading = kind.from_pretrained(
            self.model_id, use_safetensors=True, output_loading_info=True, **self.options, **options
        )
        missing = sorted(key for key in loading["missing_keys"] if not key.endswith("position_ids"))
        if missing:
            raise ScoupError(f"its file lacks weights such as {missing[0]!r}; use a complete model")
        return model.eval().float()

    def normalization(self) -> Normalization | None:
        """Return the values of preprocessor_config.json, if any (transformers' image processors need torchvision)."""
        from transformers.utils.hub import cached_file

        try:
            path = cached_file(self.model_id, "preprocessor_config.json", **self.options)
        except OSError:
            return None
        if path is None:
            return None
        record = json.loads(Path(path).read_text(encoding="utf-8"))
        if record.get("do_normalize") is False:
            return PLAIN
        mean, std = record.get("image_mean"), record.get("image_std")
        valid = all(isinstance(item, list) and len(item) == 3 for item in (mean, std))
        return Normalization(tuple(map(float, mean)), tuple(map(float, std))) if valid else None


def load_pretrained(request: ModelRequest, load: Callable[[Pretrained], Loaded]) -> Loaded:
    """Return ``load(files)`` with the files on this machine; only if that fails, with the network too."""
    if os.path.isfile(request.source):
        raise request.unusable(
            "it is a file; pass a folder with config.json and weights (safetensors), or a hub id"
        )
    if os.path.isdir(request.source):
        for file in sorted(Path(request.source).iterdir()):
            if _READ.fullmatch(file.name):
                refuse_pointer(file)
    transformers = request.package("transformers", "models")

    def load_with(options: dict[str, Any]) -> Loaded:
        return load(Pretrained(transformers, request.source, options))

    return _here_or_from_hub(request, load_with)


def hub_file(request: ModelRequest, name: str) -> Path:
    """Return the path of one file of a hub model, fetched unless it is on this machine."""
    hub = request.package("huggingface_hub", "models")
    return Path(
        _here_or_from_hub(request, lambda options: hub.hf_hub_download(request.source, name, **options))
    )


def is_cached(model_id: str, name: str) -> bool:
    """Return whether a file of a hub model is in this machine's cache of Hugging Face."""
    if find_spec("huggingface_hub") is None:
        return False
    from huggingface_hub import try_to_load_from_cache

    return isinstance(try_to_load_from_cache(model_id, name), str)


def _here_or_from_hub(request: ModelRequest, load: Callable[[dict[str, Any]], Loaded]) -> Loaded:
    """Return ``load(options)`` offline; if that fails, with the network too.

    The hub's client alone would wait half a minute for a missing network.
    """
    options: dict[str, Any] = {"revision": request.revision} if request.revision else {}
    with _quiet():
        try:
            return load({**options, "local_files_only": True})
        except ScoupError as error:
            raise request.unusable(str(error)) from error
        except Exception as error:  # hub, network, JSON and safetensors each raise kinds of their own
            if os.path.exists(request.source):
                raise request.unreadable(error) from error
        if problem := _no_hub():
            raise request.unreachable(problem)
        try:
            return load(options)
        except ScoupError as error:
            raise request.unusable(str(error)) from error
        except Exception as error:  # as above
            raise request.unreadable(error) from error


def open_clip_identity(request: ModelRequest) -> ModelIdentity:
    """Return the identity of a model of open_clip, whose weights may be a file."""
    files = file_states(_open_clip_parts(request)[1])
    package = f"open_clip {getattr(request.package('open_clip', 'open-clip'), '__version__', '')}"
    return ModelIdentity(request.name, "", package, files)


def load_open_clip(
    request: ModelRequest, device: torch.device | str, with_tokenizer: bool = False
) -> tuple[Any, Any]:
    """Load a model of open_clip in evaluation mode, and its tokenizer (None unless requested)."""
    architecture, pretrained = _open_clip_parts(request)
    open_clip = request.package("open_clip", "open-clip")
    try:
        model = open_clip.create_model(architecture, pretrained=pretrained or None, device=device).eval()
        return model, open_clip.get_tokenizer(architecture) if with_tokenizer else None
    except Exception as error:  # as above
        known = open_clip.list_models()
        if pretrained and architecture not in known:
            near = listed(difflib.get_close_matches(architecture, known), 3)
            problem = f"open_clip has no architecture {architecture!r}{near and f'; similar ones: {near}'}"
            raise request.unusable(problem) from error
        raise request.unreadable(error) from error


def _open_clip_parts(request: ModelRequest) -> tuple[str, str]:
    """Return the architecture and the pretrained weights, which may be a path; "" for a model of a hub."""
    name = request.name.removeprefix(OPEN_CLIP)
    if _OF_HUB.fullmatch(name):
        return name, ""
    name = _SPELT.sub(lambda parts: "-".join(filter(None, parts.groups())), name)
    architecture, _, pretrained = name.partition("/")
    if not architecture or not pretrained:
        raise InputError(
            f"invalid model {request.name!r}; expected {OPEN_CLIP}ARCHITECTURE/PRETRAINED, "
            f"such as {OPEN_CLIP}ViT-B-16/laion2b_s34b_b88k, or {OPEN_CLIP}hf-hub:ORG/NAME"
        )
    return architecture, pretrained


def _no_hub() -> str:
    """Return why no hub can be reached; "" if one answers, or if there is a proxy, which is not asked."""
    from huggingface_hub import constants

    if constants.HF_HUB_OFFLINE:
        return "HF_HUB_OFFLINE says to stay offline"
    hub = urlsplit(constants.ENDPOINT)
    if any(os.environ.get(name) for name in ("HTTPS_PROXY", "https_proxy", "ALL_PROXY", "all_proxy")):
        return ""
    port = hub.port or (80 if hub.scheme == "http" else 443)
    try:
        socket.create_connection((hub.hostname or "", port), timeout=_PATIENCE).close()
    except OSError:
        return f"{constants.ENDPOINT} cannot be reached"
    return ""


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence transformers and its hub: errors are raised, not printed."""
    from huggingface_hub.utils import logging as hub_logging
    from transformers.utils import logging

    verbosity, shows_progress = logging.get_verbosity(), logging.is_progress_bar_enabled()
    hub_verbosity = hub_logging.get_verbosity()
    logging.set_verbosity_error()  # it would list the weights of unused towers
    logging.disable_progress_bar()
    hub_logging.set_verbosity_error()
    try:
        yield
    finally:
        logging.set_verbosity(verbosity)
        hub_logging.set_verbosity(hub_verbosity)
        if shows_progress:
            logging.enable_progress_bar()
