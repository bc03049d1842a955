"""Fields of other systems: one feature per Gaussian by sparse coding, and checkpoints of LangSplat and LangSplatV2."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base import VERSION, FileFormatError, InputError, Progress, no_progress, scratch_array
from scoup.coding import decoded_cosines, encode, fit_codes
from scoup.field import Field, FieldInfo
from scoup.io import Decoder, load_gaussians, read_features, read_langsplat, splat_source
from scoup.scene import LEAST_EMBEDDING, Gaussians, SparseCodes, index_dtype, normalise_embeddings
from scoup.uplift.provenance import recorded_model

LEARNED_FROM = 16_384  # rows from which a codebook is learned
ROWS_AT_A_TIME = 65_536
TOP_K = 4  # LangSplatV2's
LEVELS = ("s", "m", "l")
ARRAYS = (".npy", ".pt")  # of features
_LEVEL_FOLDER = re.compile(r"(.*)_([123])")


def foreign_field(
    source: Path, gaussians: Path | None, decode: Decoder | None, read: Callable[[Path], None], **options: Any
) -> Field:
    """Make a field of features of the splat ``gaussians``, one row per Gaussian (.npy, .pt); or of a checkpoint of
    LangSplat or a relative, with those of the other levels beside it, which are passed to ``read``.

    ``options`` are those that ``field_from_features`` and ``field_from_langsplat`` share.
    """
    if gaussians is not None and source.suffix.lower() in ARRAYS:
        splat = splat_source(gaussians)
        known, rows = load_gaussians(splat.path), read_features(source)
        field = field_from_features(known, rows, raster_preset=splat.preset, **options)
        field.geometry_path = splat.path
        return field
    paths = langsplat_levels(source)
    for path in paths:
        read(path)
    return field_from_langsplat(paths, decode=decode, **options)


def field_from_features(  # noqa: PLR0913  the public face: each keyword is one choice of the user
    gaussians: Gaussians,
    features: Tensor | ArrayLike,
    n_atoms: int = 128,
    k: int = 4,
    *,
    embedding_model: str = "",
    words: str | Path | None = None,
    levels: Sequence[str] | None = None,
    seed: int = 0,
    raster_preset: str = "inria",
    progress: Progress = no_progress,
) -> Field:
    """Make a field of one feature per Gaussian, from any system: sparse codes of the features, without a vote.

    A codebook per level is learned from some of the rows (``fit_codes``), and all rows are coded by it. Only directions
    count. Rows that are zero or not finite have no code. The provenance of the field has, per level, the mean cosine of
    decoded codes and features.

    Args:
        features: [N, D], or [N, S, D] of S levels from fine to coarse; a tensor or an array, also a mapped one. Those
            of rows that the splat's reader dropped are dropped, too.
        embedding_model, words: as for ``build``.
        levels: S names; by default "m", or s, m, l.
    """
    rows = features if isinstance(features, (np.ndarray, Tensor)) else np.asarray(features)
    if rows.ndim == 2:
        rows = rows[:, None]
    kept = gaussians.source_rows
    if kept is not None and len(kept) == len(rows):
        rows = rows[kept.numpy() if isinstance(rows, np.ndarray) else kept]
    if rows.ndim != 3 or len(rows) != len(gaussians):
        raise InputError(
            f"features {list(rows.shape)} are not one row for each of {len(gaussians):,} Gaussians; use those of this "
            "splat, in its order"
        )
    names, model = _level_names(levels, rows.shape[1]), recorded_model(embedding_model, words)
    parts, books, cosines = [], [], []
    for level in range(rows.shape[1]):
        atoms = _learned_atoms(rows[:, level], n_atoms, k, seed, progress)
        codes, cosine = _coded(rows[:, level], atoms, k, names[level], progress)
        parts.append(codes)
        books.append(atoms)
        cosines.append(cosine)
    provenance = {"mean_cosine": dict(zip(names, cosines, strict=True)), "seed": seed}
    info = _info(names, (model, words), gaussians, raster_preset, "features", provenance)
    indices, weights = (
        torch.stack([getattr(item, name) for item in parts], 1) for name in ("indices", "weights")
    )
    return Field(indices, weights, torch.stack(books), info, gaussians)


def field_from_langsplat(  # noqa: PLR0913  the public face: each keyword is one choice of the user
    paths: Sequence[str | Path],
    k: int = TOP_K,
    embedding_model: str = "",
    words: str | Path | None = None,
    levels: Sequence[str] | None = None,
    *,
    decode: Decoder | None = None,
    n_atoms: int = 128,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Field:
    """Make a field of checkpoints of LangSplat, LangSplatV2 or relatives.

    LangSplatV2's have a codebook, and codes: the softmax of the logits, cut to its K largest entries and scaled to sum
    1. Of several codebooks per level (residual quantisation) the codes are added. Features of others are coded as by
    ``field_from_features``.

    Args:
        paths: one checkpoint per level, fine to coarse, of one splat.
        k: entries kept, as LangSplatV2's option topk in training.
        decode: LangSplat's autoencoder (``langsplat_autoencoder.read_autoencoder``), which its features need.
        n_atoms, seed, progress: of codes of features.
    """
    if not paths:
        raise InputError("pass at least one checkpoint of LangSplat")
    read = [read_langsplat(path) for path in paths]
    first = read[0].gaussians
    for path, level in zip(paths, read, strict=True):
        same = level.gaussians.fingerprint() == first.fingerprint()
        if not same or level.values.shape[1:] != read[0].values.shape[1:]:
            problem = f"contains another splat than {paths[0]}, or other codebooks or features"
            raise FileFormatError(Path(path), problem, "use the levels of one training")
    names = _level_names(levels, len(read))
    books = [torch.from_numpy(level.codebooks) for level in read if level.codebooks is not None]
    if not books:
        rows = _decoded_features(Path(paths[0]), [level.values for level in read], decode)
        encoder = {"embedding_model": embedding_model, "words": words}
        return field_from_features(
            first, rows, n_atoms, k, **encoder, levels=names, seed=seed, progress=progress
        )
    if not 1 <= k <= books[0].shape[1]:
        raise InputError(f"k must be 1 to {books[0].shape[1]}, got {k}")
    codes = [_top_codes(level.values, k) for level in read]
    provenance = {"files": [str(path) for path in paths], "k": k}
    encoder = recorded_model(embedding_model, words), words
    info = _info(names, encoder, first, "inria", "LangSplatV2", provenance)
    indices, weights = (torch.stack(parts, 1) for parts in zip(*codes, strict=True))
    return Field(indices, weights, torch.stack([book.flatten(0, 1) for book in books]), info, first)


def _decoded_features(path: Path, levels: Sequence[np.ndarray], decode: Decoder | None) -> np.ndarray:
    """Return [N, S, D] embeddings of features [N, C] of S levels."""
    size = levels[0].shape[1]
    if decode is None:
        if size < LEAST_EMBEDDING:
            problem = (
                f"has {size} numbers per Gaussian and not embeddings: codes of LangSplat's autoencoder, or features of "
                "instances, as of OpenGaussian"
            )
            remedy = "for codes pass the best_ckpt.pth as `autoencoder`; for others convert embeddings (.npy)"
            raise FileFormatError(path, problem, remedy)
        return np.stack(levels, 1)
    dim = decode(levels[0][:1]).shape[1]
    rows = scratch_array((len(levels[0]), len(levels), dim), np.float16)
    for number, codes in enumerate(levels):
        for start in range(0, len(codes), ROWS_AT_A_TIME):
            block = codes[start : start + ROWS_AT_A_TIME]
            # LangSplat renders codes of unit norm.
            norms = np.linalg.norm(block, axis=1, keepdims=True)
            rows[start : start + len(block), number] = decode(block / np.where(norms > 0, norms, 1))
    return rows


def langsplat_levels(path: str | Path) -> list[Path]:
    """Return the checkpoints of one training, fine to coarse: for a file in a folder NAME_1, _2 or _3 those of the same
    name in all three; otherwise the file alone."""
    path = Path(path)
    match = _LEVEL_FOLDER.fullmatch(path.absolute().parent.name)
    if not match:
        return [path]
    beside = [path.absolute().parent.parent / f"{match[1]}_{level}" / path.name for level in (1, 2, 3)]
    return beside if all(one.is_file() for one in beside) else [path]


def _level_names(levels: Sequence[str] | None, count: int) -> tuple[str, ...]:
    names = (
        tuple(levels) if levels else {1: ("m",), 3: LEVELS}.get(count, tuple(map(str, range(1, count + 1))))
    )
    if len(names) != count or len(set(names)) < count:
        raise InputError(f"{len(names)} names ({', '.join(names)}) for {count} levels")
    return names


def _info(
    levels: tuple[str, ...],
    encoder: tuple[str, str | Path | None],  # model and word table
    gaussians: Gaussians,
    preset: str,
    source: str,
    record: dict[str, Any],
) -> FieldInfo:
    provenance = {"version": VERSION, "converted_from": source, **record}
    model, table = encoder
    words = None if table is None else Path(table)
    fingerprint, world = gaussians.fingerprint(), gaussians.world
    return FieldInfo(levels, model, fingerprint, len(gaussians), preset, provenance, words, world)


def _unit(rows: Tensor | np.ndarray) -> Tensor:
    """Return [R, D] float32 of unit norm on the CPU; rows that are not finite become zero."""
    known = rows.detach().cpu().numpy() if isinstance(rows, Tensor) else rows
    values = torch.from_numpy(np.array(known, np.float32))
    return normalise_embeddings(torch.where(torch.isfinite(values).all(1, keepdim=True), values, 0.0))


def _learned_atoms(rows: Tensor | np.ndarray, n_atoms: int, k: int, seed: int, progress: Progress) -> Tensor:
    """Return a codebook [L, D] learned from rows that are not zero, a random sample of many."""
    order = torch.randperm(len(rows), generator=torch.Generator().manual_seed(seed))
    drawn: list[Tensor] = []
    for batch in order.split(LEARNED_FROM):
        chosen = batch.sort().values
        unit = _unit(rows[chosen.numpy()] if isinstance(rows, np.ndarray) else rows[chosen])
        drawn.append(unit[unit.any(1)])
        if sum(map(len, drawn)) >= LEARNED_FROM:
            break
    known = torch.cat(drawn)[:LEARNED_FROM]
    if not len(known):
        raise InputError("no Gaussian has a feature: all rows are zero or not finite")
    return fit_codes(known, n_atoms, k, seed=seed, effort="fast", progress=progress).atoms


def _coded(
    rows: Tensor | np.ndarray, atoms: Tensor, k: int, level: str, progress: Progress
) -> tuple[SparseCodes, float]:
    """Return the codes of all rows, and the mean cosine of decoded codes with rows that are not zero."""
    indices, weights, total, known = [], [], 0.0, 0
    stage = f"codes {level}"
    progress(stage, 0, len(rows))
    for start in range(0, len(rows), ROWS_AT_A_TIME):
        unit = _unit(rows[start : start + ROWS_AT_A_TIME])
        codes = encode(unit, atoms, k)
        indices.append(codes.indices)
        weights.append(codes.weights)
        total += float(decoded_cosines(unit, atoms, codes).double().sum())
        known += int(unit.any(1).sum())
        progress(stage, min(len(rows), start + ROWS_AT_A_TIME), len(rows))
    return SparseCodes(torch.cat(indices), torch.cat(weights), len(atoms)), round(total / max(1, known), 4)


def _top_codes(logits: np.ndarray, k: int) -> tuple[Tensor, Tensor]:
    """Return [N, V K] indices and weights of logits [N, V, L]."""
    _, layers, size = logits.shape
    indices, weights = [], []
    for layer in range(layers):
        soft = torch.from_numpy(logits[:, layer]).softmax(1)
        values, places = torch.sort(soft, dim=1, descending=True, stable=True)
        weights.append(values[:, :k] / values[:, :k].sum(1, keepdim=True) / layers)
        indices.append(places[:, :k] + layer * size)
    return torch.cat(indices, 1).to(index_dtype(layers * size)), torch.cat(weights, 1)
