"""Fields of other systems: a feature a Gaussian by sparse coding, and LangSplatV2's codes as they are."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base.errors import FileFormatError, InputError
from scoup.base.progress import Progress, no_progress
from scoup.base.version import VERSION
from scoup.coding import fit_codes
from scoup.coding.encode import encode
from scoup.field.language_field import LanguageField
from scoup.io.langsplatv2 import LangSplatV2Level, read_langsplatv2
from scoup.io.npy import open_npy
from scoup.io.torch_file import load_torch
from scoup.scene.codes import SparseCodes, index_dtype
from scoup.scene.directions import normalise_embeddings
from scoup.scene.field_info import FieldInfo
from scoup.scene.gaussians import Gaussians

LEARNED_FROM = 16_384  # rows that a codebook is learned from
ROWS_AT_A_TIME = 65_536
TOP_K = 4  # LangSplatV2's
LEVELS = ("s", "m", "l")
_LEVEL_FOLDER = re.compile(r"(.*)_([123])")


def read_features(path: str | Path) -> np.ndarray:
    """An array of features, one row a Gaussian: [N, D], or [N, S, D] of S levels.

    Args:
        path: .npy (mapped, not read), or .pt, .pth with one tensor.

    Raises:
        MissingFileError: there is no such file.
        FileFormatError: it is damaged, or holds something else.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        features = open_npy(path, "features of Gaussians")
    elif suffix in (".pt", ".pth"):
        content = load_torch(
            path, "a tensor of features", "save the tensor alone: torch.save(features, path)"
        )
        if not isinstance(content, Tensor) or content.layout != torch.strided:
            raise FileFormatError(
                path, "holds no tensor", "save the tensor alone: torch.save(features, path)"
            )
        if content.numel() * content.element_size() > path.stat().st_size:
            raise FileFormatError(path, "claims more numbers than it holds", "save the tensor again")
        features = content.detach().float().numpy()
    else:
        raise FileFormatError(
            path, "is no array of features", "give .npy or .pt with [Gaussians, dimensions]"
        )
    if features.dtype.kind != "f" or features.ndim not in (2, 3) or 0 in features.shape:
        problem = f"is {features.dtype} {list(features.shape)}, expected floats [N, D] or [N, levels, D]"
        raise FileFormatError(path, problem, "save one row a Gaussian")
    return features


def field_from_features(  # noqa: PLR0913  the public face: each keyword is one choice of the user
    gaussians: Gaussians,
    features: Tensor | ArrayLike,
    n_atoms: int = 128,
    k: int = 4,
    *,
    embedding_model: str = "",
    levels: Sequence[str] | None = None,
    seed: int = 0,
    raster_preset: str = "inria",
    progress: Progress = no_progress,
) -> LanguageField:
    """A field of a feature a Gaussian, from whatever system: sparse codes of the features, no vote.

    A codebook a level is learned from some of the rows (``fit_codes``), and all rows are coded by it. Only directions
    count. Rows of zeros, and rows that are not finite, have no code.

    Args:
        gaussians: N of them.
        features: [N, D], or [N, S, D] of S levels from fine to coarse; a tensor or an array, mapped ones too.
        n_atoms: L, of each codebook.
        k: K, the most atoms of a code.
        embedding_model: id of the model, or file of the word table, that queries must come from.
        levels: S names; by default "m", or s, m, l.
        seed: of which rows are learned from, and of the codebook.
        raster_preset: constants that the field is rendered with.
        progress: called for the stages "coding" and "codes".

    Returns:
        A field whose provenance has the mean cosine of decoded codes with features, a level.

    Raises:
        InputError: there is not one feature a Gaussian, no row is known, or a number is out of range.
    """
    rows = features if isinstance(features, (np.ndarray, Tensor)) else np.asarray(features)
    if rows.ndim == 2:
        rows = rows[:, None]
    if rows.ndim != 3 or len(rows) != len(gaussians):
        raise InputError(
            f"features {list(rows.shape)} are not one row for each of {len(gaussians):,} Gaussians; give those of this "
            "splat, in its order"
        )
    names = _level_names(levels, rows.shape[1])
    parts, books, cosines = [], [], []
    for level in range(rows.shape[1]):
        atoms = _learned_atoms(rows[:, level], n_atoms, k, seed, progress)
        codes, cosine = _coded(rows[:, level], atoms, k, names[level], progress)
        parts.append(codes)
        books.append(atoms)
        cosines.append(cosine)
    provenance = {"mean_cosine": dict(zip(names, cosines, strict=True)), "seed": seed}
    info = _info(names, embedding_model, gaussians, raster_preset, "features", provenance)
    indices, weights = (
        torch.stack([getattr(part, name) for part in parts], 1) for name in ("indices", "weights")
    )
    return LanguageField(indices, weights, torch.stack(books), info, gaussians)


def field_from_langsplatv2(
    paths: Sequence[str | Path],
    k: int = TOP_K,
    embedding_model: str = "",
    levels: Sequence[str] | None = None,
) -> LanguageField:
    """A field of LangSplatV2's checkpoints: their codebooks, and the codes that their renderer takes from the logits.

    A code is the softmax of the logits, cut to its K largest entries and scaled to sum 1. Of several codebooks a
    level (residual quantisation) the codes are added.

    Args:
        paths: a checkpoint a level, fine to coarse, of one splat.
        k: entries kept, as in the training (``--topk``).
        embedding_model: as for ``field_from_features``; LangSplatV2 trains with open_clip's ViT-B-16.
        levels: names of the levels; by default "m", or s, m, l.

    Raises:
        MissingFileError, FileFormatError: as ``read_langsplatv2``, or the checkpoints are of different splats.
        InputError: there is no checkpoint, or K is out of range.
    """
    if not paths:
        raise InputError("give at least one checkpoint of LangSplatV2")
    read = [read_langsplatv2(path) for path in paths]
    first = read[0]
    for path, level in zip(paths, read, strict=True):
        same = level.gaussians.fingerprint() == first.gaussians.fingerprint()
        if not same or level.codebooks.shape != first.codebooks.shape:
            problem = f"holds another splat than {paths[0]}, or other codebooks"
            raise FileFormatError(Path(path), problem, "give the levels of one training")
    if not 1 <= k <= first.codebooks.shape[1]:
        raise InputError(f"k must be 1 to {first.codebooks.shape[1]}, got {k}")
    names = _level_names(levels, len(read))
    codes = [_top_codes(level, k) for level in read]
    books = torch.stack([torch.from_numpy(level.codebooks).flatten(0, 1) for level in read])
    provenance = {"files": [str(path) for path in paths], "k": k}
    info = _info(names, embedding_model, first.gaussians, "inria", "LangSplatV2", provenance)
    indices, weights = (torch.stack(parts, 1) for parts in zip(*codes, strict=True))
    return LanguageField(indices, weights, books, info, first.gaussians)


def langsplatv2_levels(path: str | Path) -> list[Path]:
    """The checkpoints that belong together: of a file in a folder NAME_1, _2 or _3 also those of the same name in the
    other two, fine to coarse; otherwise the file alone."""
    path = Path(path)
    found = _LEVEL_FOLDER.fullmatch(path.absolute().parent.name)
    if not found:
        return [path]
    beside = [path.absolute().parent.parent / f"{found[1]}_{level}" / path.name for level in (1, 2, 3)]
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
    model: str,
    gaussians: Gaussians,
    preset: str,
    source: str,
    record: dict[str, Any],
) -> FieldInfo:
    provenance = {"version": VERSION, "converted_from": source, **record}
    return FieldInfo(levels, model, gaussians.fingerprint(), len(gaussians), preset, provenance)


def _unit(rows: Tensor | np.ndarray) -> Tensor:
    """[R, D] float32 of unit norm on the CPU; rows that are zero or not finite are zero."""
    known = rows.detach().cpu().numpy() if isinstance(rows, Tensor) else rows
    values = torch.from_numpy(np.array(known, np.float32))
    return normalise_embeddings(torch.where(torch.isfinite(values).all(1, keepdim=True), values, 0.0))


def _learned_atoms(rows: Tensor | np.ndarray, n_atoms: int, k: int, seed: int, progress: Progress) -> Tensor:
    """[L, D] a codebook from known rows, drawn by the seed where there are many."""
    order = torch.randperm(len(rows), generator=torch.Generator().manual_seed(seed))
    drawn: list[Tensor] = []
    for part in order.split(LEARNED_FROM):
        chosen = part.sort().values
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
    """Codes of all rows, and the mean cosine of the decoded with the known ones."""
    indices, weights, total, known = [], [], 0.0, 0
    stage = f"codes {level}"
    progress(stage, 0, len(rows))
    for start in range(0, len(rows), ROWS_AT_A_TIME):
        unit = _unit(rows[start : start + ROWS_AT_A_TIME])
        codes = encode(unit, atoms, k)
        indices.append(codes.indices)
        weights.append(codes.weights)
        dense = codes.to_dense()
        lengths = torch.linalg.norm(dense @ atoms, dim=1)
        cosine = ((dense @ atoms) * unit).sum(1) / lengths.clamp(min=1e-12)
        total += float(cosine[unit.any(1)].double().sum())
        known += int(unit.any(1).sum())
        progress(stage, min(len(rows), start + ROWS_AT_A_TIME), len(rows))
    return SparseCodes(torch.cat(indices), torch.cat(weights), len(atoms)), round(total / max(1, known), 4)


def _top_codes(level: LangSplatV2Level, k: int) -> tuple[Tensor, Tensor]:
    """[N, V K] indices and weights of a level."""
    _, layers, size = level.logits.shape
    indices, weights = [], []
    for layer in range(layers):
        soft = torch.from_numpy(level.logits[:, layer]).softmax(1)
        values, places = torch.sort(soft, dim=1, descending=True, stable=True)
        weights.append(values[:, :k] / values[:, :k].sum(1, keepdim=True) / layers)
        indices.append(places[:, :k] + layer * size)
    return torch.cat(indices, 1).to(index_dtype(layers * size)), torch.cat(weights, 1)
