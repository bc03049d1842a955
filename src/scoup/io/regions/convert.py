"""Region features of any folder to another folder, in the compact layout."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from scoup.base import InputError, MissingFileError, Progress, listed, no_progress
from scoup.io.regions import compact, langsplat
from scoup.io.regions.langsplat_autoencoder import Decoder
from scoup.io.regions.manifest import MANIFEST, RegionManifest
from scoup.io.regions.store import RegionStore, read_view, staged_store
from scoup.io.regions.views import FEATURES_FOLDER


@dataclass(frozen=True)
class ConvertReport:
    source: Path
    target: Path
    views: int  # that were converted
    bytes_before: int  # size of the views' files in the source
    bytes_after: int  # and in the target


def convert_regions(
    source: str | Path,
    target: str | Path,
    bits: int = 16,
    embedding_model: str | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
    decode: Decoder | None = None,
) -> ConvertReport:
    """Write the region features of a folder, such as LangSplat's, in the compact layout into another folder.

    Labels are kept exactly, the level "default" included, and embeddings with ``bits`` = 32; with 16 they are rounded
    to float16.

    Args:
        source: the features, or a scene folder with ``language_features`` in it.
        target: another folder; views there that are not in the source stay.
        bits: of a stored embedding number, 16 or 32.
        embedding_model: id of the model that made the embeddings, where the source does not tell.
        overwrite: replace views that are there already.
        decode: what turns the stored numbers of regions into embeddings (``langsplat_autoencoder.read_autoencoder``).
    """
    store = RegionStore.open(source)
    target = Path(target)
    if target.exists() and target.resolve() in (store.folder.resolve(), Path(source).resolve()):
        raise InputError(
            f"{target}: source and target are one folder; use a new folder, such as "
            f"{store.folder.with_name(f'{store.folder.name}_compact')}"
        )
    model, settings = "", {}
    if store.manifest is not None:
        model, settings = store.manifest.embedding_model, dict(store.manifest.settings)
    settings |= {"converted_from": store.layout}
    manifest = RegionManifest.of(embedding_model or model, settings, bits)
    stems = store.stems()
    if not stems:
        problem = "contains no region features"
        raise MissingFileError(store.folder, problem, "use a folder with *_s.npy or *.regions files")
    _check_target(target)
    before = after = 0
    progress("convert", 0, len(stems))
    with staged_store(target, manifest, stems, overwrite) as out:
        for done, stem in enumerate(stems):
            regions = read_view(store.open_view(stem))
            if decode is not None:
                rows = {level: decode(stored) for level, stored in regions.embeddings.items()}
                regions = replace(regions, embeddings=rows)
            after += out.write(regions, stem)
            before += store.size_of(stem)
            progress("convert", done + 1, len(stems))
    return ConvertReport(store.folder, target, len(stems), before, after)


def _check_target(target: Path) -> None:
    endings = (MANIFEST, *compact.ENDINGS, *langsplat.ENDINGS)
    places = (path.relative_to(target) for path in target.rglob("*") if not path.is_dir())
    others = (file for file in places if not file.name.endswith(endings))
    shown = (file.parts[0] for file in others if not any(name.startswith(".") for name in file.parts))
    if foreign := sorted(set(islice(shown, 1000))):
        raise InputError(
            f"{target}: contains other files than region features ({listed(foreign)}); use a folder for them alone, "
            f"such as {target / FEATURES_FOLDER}"
        )
