"""The study of embeddings with tiny models in place of the real size, on a photograph that is made up."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from benchmarks import embed

from mask_samples import random_masks, smooth_image
from scoup.extract.masks import Masks
from tiny_models import saved, tiny_clip, tiny_siglip


@pytest.mark.parametrize("model", [tiny_clip, tiny_siglip])
@pytest.mark.parametrize("way", ["dense", "crops"])
def test_a_way_is_timed(model, way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    masks = random_masks(12, 40, 50, seed=1)
    masks = Masks.from_dense(masks[masks.any((1, 2))])
    photograph = torch.from_numpy(smooth_image(40, 50)), {"s": masks, "m": masks.select([0])}
    monkeypatch.setattr(embed, "_photograph", lambda: photograph)
    found = embed._embed(str(saved(model(), tmp_path)), way, torch.get_num_threads(), 2)
    assert found["regions"] == len(masks) + 1
    assert found["seconds"] > 0
    assert found["peak_gb"] > 0.1
    rows = {f"{name}/{way}": found for name in embed.MODELS}
    assert embed.Embedding.table({"rows": rows, "settings": {"threads": 2}}).count("\n") == 3
