"""Region features from one layout to the other: LangSplat's and the compact one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from scoup.base.counts import listed
from scoup.base.errors import InputError, MissingFileError
from scoup.base.progress import Progress, no_progress
from scoup.base.staging import staged
from scoup.io.regions import compact, langsplat
from scoup.io.regions.langsplat_autoencoder import Decoder
from scoup.io.regions.manifest import MANIFEST, Layout, RegionManifest, read_manifest, write_manifest
from scoup.io.regions.store import RegionStore, read_view
from scoup.io.regions.views import FOLDER_NAME


@dataclass(frozen=True)
class ConvertReport:
    """A report of a conversion."""

    source: Path
    target: Path
    layout: Layout  # of the target
    views: int  # that were converted
    bytes_before: int  # size of the views' files in the source
    bytes_after: int  # and in the target


def convert_regions(
    source: str | Path,
    target: str | Path,
    layout: Layout | None = None,
    bits: int = 16,
    embedding_model: str | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
    decode: Decoder | None = None,
) -> ConvertReport:
    """Write the region features of a folder in the other layout, into another folder.

    Labels are kept exactly, the level "default" included. From LangSplat's layout with ``bits`` = 32 and back gives
    the same numbers; with 16 embeddings are rounded to float16. Back from the compact layout float16 numbers become
    float32 without loss.

    Args:
        source: the features, or a scene folder with ``language_features`` in it.
        target: another folder; views there that are not in the source stay.
        layout: of the target; the other one if None.
        bits: of a stored embedding number in the compact layout, 16 or 32.
        embedding_model: id of the model that made the embeddings, where the source does not tell.
        overwrite: replace views that are there already.
        decode: what turns the stored numbers of regions into embeddings (``langsplat_autoencoder.read_autoencoder``).
    """
    store = RegionStore.open(source)
    target = Path(target)
    if target.exists() and target.resolve() in (store.folder.resolve(), Path(source).resolve()):
        raise InputError(
            f"{target}: source and target are one folder; use a new folder, such as "
            f"{store.folder.with_name(f'{store.folder.name}_{layout or _other(store.layout)}')}"
        )
    to_layout = layout or _other(store.layout)
    model, settings = "", {}
    if store.manifest is not None:
        model, settings = store.manifest.embedding_model, dict(store.manifest.settings)
    settings |= {"converted_from": store.layout}
    manifest = RegionManifest.of(to_layout, embedding_model or model, settings, bits)
    stems = store.stems()
    if not stems:
        problem = "contains no region features"
        raise MissingFileError(store.folder, problem, "use a folder with *_s.npy or *.regions files")
    # LangSplat's names have no folders, and end at the first dot.
    targets = {stem: langsplat.stem_of(stem) if to_layout == "langsplat" else stem for stem in stems}
    if to_layout == "langsplat":
        RegionStore(target).check_names(stems)
    _check_target(target, manifest, targets.values(), overwrite)
    RegionStore.create(target, manifest, overwrite)
    before = after = 0
    progress("convert", 0, len(stems))
    manifest_file = [] if read_manifest(target) == manifest else [MANIFEST]
    with staged(target, manifest_file, overwrite) as hidden:
        out = RegionStore(hidden, manifest, to_layout)
        if manifest_file:
            write_manifest(hidden, manifest)
        for done, stem in enumerate(stems):
            regions = read_view(store.open_view(stem))
            if decode is not None:
                rows = {level: decode(stored) for level, stored in regions.embeddings.items()}
                regions = replace(regions, embeddings=rows)
            after += out.write(regions, targets[stem])
            before += store.size_of(stem)
            progress("convert", done + 1, len(stems))
    return ConvertReport(store.folder, target, to_layout, len(stems), before, after)


def _other(layout: Layout) -> Layout:
    return "langsplat" if layout == "compact" else "compact"


def _check_target(target: Path, manifest: RegionManifest, stems: Iterable[str], overwrite: bool) -> None:
    """Refuse what would be mixed up or replaced, before anything is written."""
    if not target.is_dir():
        return
    endings = (MANIFEST, *compact.ENDINGS, *langsplat.ENDINGS)
    places = (path.relative_to(target) for path in target.rglob("*") if not path.is_dir())
    others = (place for place in places if not place.name.endswith(endings))
    shown = (place.parts[0] for place in others if not any(part.startswith(".") for part in place.parts))
    if foreign := sorted(set(islice(shown, 1000))):
        raise InputError(
            f"{target}: contains other files than region features ({listed(foreign)}); use a folder for them alone, "
            f"such as {target / f'{FOLDER_NAME}_{manifest.layout}'}"
        )
    there = RegionStore.open(target)
    present = there.all_stems()
    if present and there.layout != manifest.layout:
        first = present[0] + there.endings[0]
        raise InputError(
            f"{target}: contains features of the layout {there.layout} ({first}); choose another folder"
        )
    if there.manifest in (None, manifest):
        RegionStore(target, manifest, manifest.layout).check_free(stems, overwrite)
