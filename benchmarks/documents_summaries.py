"""Summaries of records for the documents: a few rows where the record has many."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.answers import difference_cell
from benchmarks.documents_claims import Records
from scoup_lab.bench import markdown


def baselines(record: Records) -> str:
    """Return every method: scores in views, what the default gains, scores in space, cost."""
    plain, differences, selected = (table["rows"] for table in record("eval-baselines")["tables"])
    gains = {name.removeprefix("sparse - "): gain for name, gain in differences}
    in_space = {name: f"{score} ({ends})" for name, score, ends in selected}
    rows = [
        [name, score, gains.get(name, "-"), located, in_space[name], fit, query, size]
        for name, score, _, located, _, fit, query, size, *_ in plain
    ]
    heads = ["method", "mIoU", "sparse minus it", "localisation", "3D selection, mIoU", "fit, s"]
    return markdown([*heads, "query per frame, ms", "bytes per Gaussian"], rows)


def ablations(record: Records) -> str:
    """Return every change of the base, of three records; Adam ran with one codebook seed."""
    rows = []
    for name, note in {"": "", "-entropy": "", "-adam": " (one seed)"}.items():
        for change, _, score, *_, gain, published in record(f"eval-ablations{name}")["tables"][0]["rows"]:
            if gain != "-" or not name:
                rows.append([change + note, score, gain, published.partition(" / ")[0]])
    return markdown(["change", "mIoU", "minus base", "paper's mIoU"], rows)


def answers(record: Records, name: str, rules: Sequence[str]) -> str:
    """Return each set of scenes by each rule: every way, then the differences from the default."""
    ways, differences = record(name)["ways"], record(name)["differences"]
    pairs = [pair for pair in ("default - paper", "default - dense") if pair in differences]
    rows = [
        [
            key.removesuffix(", clean"),
            rule,
            *(f"{of[key][rule]:.3f}" for of in ways.values()),
            *(difference_cell(differences[pair][key][rule]) for pair in pairs),
        ]
        for key in next(iter(ways.values()))
        if key != "all"
        for rule in rules
    ]
    return markdown(["scenes", "rule", *ways, *pairs], rows, left=2)


FAMILIES = {
    "SCOUP's own (fields, sums, shards, `.regions`)": "regions; regions.json; field; field with a splat beside it; "
    "region sums; scene of region sums; codes of region sums; shards",
    "splats": "ksplat; sog; ply; ascii ply; compressed ply; splat; spz; spz of streams; spz, unpacked; glb; "
    "spz in glb; gltf; scenesplat",
    "checkpoints": "checkpoint; splatfacto; LangSplatV2; autoencoder",
    "COLMAP": "cameras.bin; images.bin; points3D.bin; cameras.txt; images.txt; points3D.txt",
    "JSON and settings of trainers": "transforms.json; cameras.json; cfg_args; config.yml; dataparser_transforms.json; "
    "cfg.yml",
    "LangSplat's regions": "region labels; region embeddings",
    "labels, labelled points": "labelled ply; labelled npy; labels",
    "word tables": "words.npz; words.json; words.safetensors",
    "pictures": "png; jpg; webp; bmp; tif",
}
"""Readers of the study on damaged files by what they read."""


def damaged(record: Records) -> str:
    """Return what became of damaged files, by what is read."""
    found = {row["reader"]: row for row in record("hostile")["readers"]}
    rows = []
    for title, names in FAMILIES.items():
        of = [found.pop(name) for name in names.split("; ")]
        files, accepted, refused = (sum(row[key] for row in of) for key in ("files", "accepted", "refused"))
        counts = (f"{count:,}" for count in (files, accepted, refused, files - accepted - refused))
        rows.append([title, str(len(of)), *counts])
    assert not found
    return markdown(["files", "readers", "damaged", "accepted", "refused", "failures"], rows)
