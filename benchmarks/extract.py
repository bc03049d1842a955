"""Each stage of extraction against the literal rules of SAM and LangSplat, on the same masks in one run.

    python -m benchmarks.extract [--masks 300 1000] [--height 1080] [--width 1440] [--pairs 1500] [--all-pairs]
        [--models] [--data DATA] [--threads 1] [--out FILE.json]

Stages: `mask rule` (LangSplat's suppression of masks), `clean-up` (SAM's small holes and islands), `painting`,
`crops` (to 224 x 224). Literal: one mask, or one pair of masks, at a time at full size, as the published code does it.
Pairs are many (500,000 of 1000 masks), so the loop is timed on ``--pairs`` random ones and scaled up; with ``--all-
pairs`` it runs through, and what it keeps is compared. Clean-up and crops are timed on ``--literal-masks`` masks
and scaled up; the suppression of boxes after the clean-up is in neither side. OpenCV is used by the literal stages
where it is installed, as the published code uses it. `matrix product` is the plain way to vectorise intersections:
one row of 0 and 1 a mask. Times are seconds of the processor (all threads together), which other programs on the
machine disturb least. Memory is the most that Python objects and arrays held above the start.

``--models`` adds seconds an image of the models themselves at their real sizes, with random weights (their speed does
not depend on the weights): SAM ViT-B encoding one crop and predicting masks of 64 points, CLIP ViT-B/16 on 8 crops.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from tests.literal_rules import box_of, mask_rule, painted

from benchmarks.data import data_folder
from benchmarks.extract_masks import candidates, photograph_of, regions_of
from scoup.extract.crops import mask_crops
from scoup.extract.masks import Masks, paint
from scoup.extract.overlaps import intersections, keep_by_masks
from scoup.extract.small_parts import cleaned_up
from scoup.io import check_output
from scoup_lab.bench import describe_environment, write_json

SIDE = 224
LEAST = 100
PRODUCT_UP_TO = 500  # masks; it takes a minute for 1000


@dataclass(frozen=True)
class Arguments:
    masks: tuple[int, ...] = (300, 1000)
    """Numbers of candidate masks."""
    height: int = 1080
    """Of the image, in pixels."""
    width: int = 1440
    """Of the image, in pixels."""
    pairs: int = 1500
    """Pairs the literal mask rule is timed on."""
    all_pairs: bool = False
    """Run the literal mask rule through, and compare."""
    literal_masks: int = 60
    """Masks the literal stages of single masks are timed on."""
    models: bool = False
    """Time the models too, with random weights."""
    threads: int = 1
    """Threads of torch."""
    data: Path = field(default_factory=data_folder)
    """Folder that holds desk/."""
    out: Path | None = None
    """Where to write the figures as JSON."""


def main(arguments: Arguments) -> dict[str, Any]:
    """Measure, print a table, write JSON."""
    if arguments.out is not None:
        check_output(arguments.out)
    torch.set_num_threads(arguments.threads)
    image, where = photograph_of(arguments.data, arguments.height, arguments.width)
    print(f"{arguments.width} x {arguments.height}, masks from: {where}; literal with {_library()}\n")
    regions = regions_of(image)
    rows: list[dict[str, Any]] = []
    print("| masks | stage | literal s | ours s | ratio | ours, peak MB | agreement |")
    print("|---|---|---|---|---|---|---|")
    for count in arguments.masks:
        masks = candidates(regions, count)
        for row in _stages(image, masks, arguments):
            row = {"masks": count, **row, "ratio": row["literal_s"] / row["ours_s"]}
            rows.append(row)
            mark = "" if row["measured_in_full"] else "~"
            print(
                f"| {count} | {row['stage']} | {mark}{row['literal_s']:.2f} | {row['ours_s']:.3f} | "
                f"{mark}{row['ratio']:.0f} | {row['ours_peak_mb']:.0f} | {row['agreement']} |",
                flush=True,
            )
    print("\n~ scaled up from a part; see the head of the script.")
    record = {
        "environment": describe_environment(),
        "settings": {"image": where, "library": _library(), "threads": arguments.threads},
        "rows": rows,
        "models": _models(image) if arguments.models else [],
    }
    for row in record["models"]:
        print(f"{row['what']}: {row['seconds']:.2f} s")
    if arguments.out is not None:
        write_json(arguments.out, record)
    return record


def _stages(image: np.ndarray, masks: Masks, arguments: Arguments):
    """One row a stage."""
    rng = np.random.default_rng(1)
    count = len(masks)
    dense = masks.dense()
    scores = masks.stability.astype(np.float64) * masks.predicted_iou.astype(np.float64)
    few = np.sort(rng.choice(count, min(count, arguments.literal_masks), replace=False)).tolist()
    scale = count / len(few)

    kept, ours, peak = _timed(lambda: keep_by_masks(masks, scores))
    all_of_them = count * (count - 1) // 2
    share = 1.0 if arguments.all_pairs else min(1.0, arguments.pairs / all_of_them)
    chosen = rng.random((count, count)) < share
    tensor, weights = torch.from_numpy(dense), torch.from_numpy(scores)
    since = time.process_time()
    literal_kept = mask_rule(tensor, weights, pairs=lambda i, j: share == 1.0 or bool(chosen[i, j]))
    looked = all_of_them if share == 1.0 else int(np.triu(chosen, 1).sum())
    literal = (time.process_time() - since) * all_of_them / max(1, looked)
    agreement = "all pairs of it"
    if share == 1.0:
        agreement = f"{len(kept)} kept, the same" if kept.tolist() == literal_kept else "DIFFERENT"
    yield _row("mask rule", literal, ours, peak, agreement if share == 1.0 else "not compared", share == 1.0)

    if count <= PRODUCT_UP_TO:
        table, ours_table, _ = _timed(lambda: intersections(masks))
        since = time.process_time()
        product = _matrix_product(dense)
        plain = time.process_time() - since
        same = "the same" if (table == product).all() else "DIFFERENT"
        yield _row("intersections: matrix product", plain, ours_table, peak, same)

    cleaned, ours, peak = _timed(lambda: cleaned_up(masks, LEAST)[0])
    since = time.process_time()
    literal_cleaned = [_clean_up(dense[number]) for number in few]
    literal = (time.process_time() - since) * scale
    equal = bool((cleaned.select(few).dense() == np.stack(literal_cleaned)).all())
    yield _row("clean-up", literal, ours, peak, _verdict(equal, len(few)), scale == 1)

    labels, ours, peak = _timed(lambda: paint(masks))
    since = time.process_time()
    expected = painted(list(dense), masks.size)
    literal = time.process_time() - since
    yield _row("painting", literal, ours, peak, "the same" if (labels == expected).all() else "DIFFERENT")

    pixels = torch.from_numpy(image.copy())
    crops, ours, peak = _timed(lambda: torch.cat(list(mask_crops(pixels, masks, SIDE))).numpy())
    since = time.process_time()
    literal_crops = [_crop(image, dense[number]) for number in few]
    literal = (time.process_time() - since) * scale
    worst = max(
        float(np.abs(crops[n].astype(int) - crop).max()) for n, crop in zip(few, literal_crops, strict=True)
    )
    yield _row(
        "crops", literal, ours, peak, f"{len(few)} compared, differ by at most {worst:.0f}", scale == 1
    )


def _row(
    stage: str, literal: float, ours: float, peak: float, agreement: str, full: bool = True
) -> dict[str, Any]:
    return {
        "stage": stage, "literal_s": literal, "ours_s": ours, "ours_peak_mb": peak / 1e6,
        "agreement": agreement, "measured_in_full": full,
    }  # fmt: skip


def _timed(run: Callable[[], Any]) -> tuple[Any, float, float]:
    """Result, the better of two times in seconds, and the peak of memory in bytes (of a run of its own)."""
    times: list[float] = []
    result: Any = None
    for _ in range(2):
        since = time.process_time()
        result = run()
        times.append(time.process_time() - since)
    tracemalloc.start()
    run()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return result, min(times), peak


def _matrix_product(dense: np.ndarray, rows: int = 1 << 16) -> np.ndarray:
    """Intersections of all pairs as products of 0 and 1, a block of pixels at a time."""
    flat = torch.from_numpy(dense).flatten(1)
    total = torch.zeros(len(flat), len(flat), dtype=torch.float64)
    for start in range(0, flat.shape[1], rows):
        block = flat[:, start : start + rows].float()
        total += block @ block.T
    return total.long().numpy()


def _library() -> str:
    try:
        import cv2  # pyright: ignore[reportMissingImports]
    except ImportError:
        return "scipy and torch"
    cv2.setNumThreads(1)
    return f"OpenCV {cv2.__version__}"


def _clean_up(mask: np.ndarray) -> np.ndarray:
    """SAM's two passes over a mask of the whole image: label, measure, fill or remove."""
    for holes in (True, False):
        working = (mask ^ holes).astype(np.uint8)
        try:
            import cv2  # pyright: ignore[reportMissingImports]

            count, labels, stats, _ = cv2.connectedComponentsWithStats(working, connectivity=8)
            sizes = stats[1:, -1]
        except ImportError:
            from scipy import ndimage

            labels = np.zeros(mask.shape, np.int32)
            count = 1 + int(ndimage.label(working, np.ones((3, 3)), output=labels))  # pyright: ignore
            sizes = np.bincount(labels.ravel(), minlength=count)[1:]
        small = [number for number in range(1, count) if sizes[number - 1] < LEAST]
        if not small:
            continue
        keep = [0, *small] if holes else [number for number in range(1, count) if number not in small]
        if not keep:
            keep = [1 + int(np.argmax(sizes))]
        mask = np.isin(labels, keep)
    return mask


def _verdict(equal: bool, compared: int) -> str:
    return f"{compared} compared, the same" if equal else "DIFFERENT"


def _crop(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """LangSplat's steps: copy the image, blacken, slice, square, resize."""
    black = image.copy()
    black[~mask] = 0
    x0, y0, x1, y1 = box_of(mask)
    cut = black[y0 : max(y1, y0 + 1), x0 : max(x1, x0 + 1)]
    height, width = cut.shape[:2]
    length = max(height, width)
    square = np.zeros((length, length, 3), np.uint8)
    top, left = (length - height) // 2, (length - width) // 2
    square[top : top + height, left : left + width] = cut
    try:
        import cv2  # pyright: ignore[reportMissingImports]

        return cv2.resize(square, (SIDE, SIDE))
    except ImportError:
        values = torch.from_numpy(square).permute(2, 0, 1)[None].float()
        large = torch.nn.functional.interpolate(values, (SIDE, SIDE), mode="bilinear", align_corners=False)
        return (large[0].permute(1, 2, 0) + 0.5).clamp(max=255).to(torch.uint8).numpy()


def _models(image: np.ndarray) -> list[dict[str, Any]]:
    """Seconds of the models at their real sizes."""
    import transformers

    from scoup.models.normalization import IMAGENET
    from scoup.models.sam import Sam

    sam = Sam(transformers.SamModel(transformers.SamConfig()).eval(), "random", "", 1024, False, IMAGENET)
    since = time.process_time()
    encoded = sam.encode(image)
    encode = time.process_time() - since
    since = time.process_time()
    encoded.predict(torch.rand(64, 2) * 1000)
    predict = time.process_time() - since
    config = transformers.CLIPVisionConfig(patch_size=16, projection_dim=512)
    clip = transformers.CLIPVisionModelWithProjection(config).eval()
    since = time.process_time()
    with torch.inference_mode():
        clip(pixel_values=torch.randn(8, 3, 224, 224))
    return [
        {"what": "SAM ViT-B encodes a crop (an image with langsplat: 5, fast: 1)", "seconds": encode},
        {
            "what": "SAM predicts masks of 64 points (an image with langsplat: 80 times, fast: 16)",
            "seconds": predict,
        },
        {"what": "CLIP ViT-B/16, 8 crops", "seconds": time.process_time() - since},
    ]


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
