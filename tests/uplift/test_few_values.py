"""A build from the embeddings of a panoptic segmenter: the codes of Gaussians are votes of classes."""

from __future__ import annotations

import torch

import scoup
from scoup.scene import RegionMap, Regions, SparseCodes
from scoup.uplift.rasterise import region_sums
from support import small_scene, unit

CLASSES = 5


def panoptic(regions: Regions) -> tuple[Regions, torch.Tensor, torch.Tensor]:
    """One level of the regions, each with the vector of a class; the vectors, and the class of each region."""
    generator = torch.Generator().manual_seed(0)
    vectors = unit(torch.randn(CLASSES, 24, generator=generator) + 1)
    maps, classes = {}, []
    for name in regions.view_names:
        labels = regions.load(name, "m").labels
        classes.append(torch.randint(CLASSES, (int(labels.max()) + 1,), generator=generator))
        maps[name] = {"m": RegionMap(labels, vectors[classes[-1]])}
    return Regions.from_maps(maps), vectors, torch.cat(classes)


def test_codes_are_the_shares_of_the_classes() -> None:
    gaussians, cameras, regions = small_scene()
    regions, vectors, classes = panoptic(regions)
    assert len(classes) >= 2 * CLASSES
    field = scoup.build(gaussians, cameras, regions, scoup.BuildSettings(rounds=1))

    sums = region_sums(gaussians, cameras, regions)
    one_hot = torch.nn.functional.one_hot(classes, CLASSES).float()
    shares = SparseCodes.from_dense(torch.from_numpy(sums.matrix(0) @ one_hot.numpy()), 4)
    found = field.codebook[0][field.code_indices[:, 0].long()]  # [N, 4, D]
    assert int(field.coded().sum()) > 10
    used = shares.weights > 0
    assert ((field.code_weights[:, 0].float() > 0) == used).all()
    torch.testing.assert_close(found[used], vectors[shares.indices.long()[used]], atol=1e-3, rtol=0)
    torch.testing.assert_close(field.code_weights[:, 0].float(), shares.weights, atol=1e-3, rtol=0)
