"""LangSplat's autoencoder, tiny: it learns, it has the layers it should, and it refuses what it cannot use."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from messages import refuses
from scoup_lab.baselines.autoencoder import (
    LANGSPLAT,
    AutoencoderSettings,
    fit_autoencoder,
    reconstruction_loss,
)

SMALL = AutoencoderSettings(epochs=12, batch=16, learning_rate=1e-2, encoder=(16, 3), decoder=(16,))


def clusters(count: int = 120, dim: int = 12, seed: int = 0) -> Tensor:
    """[count, dim] rows around four directions, of any norm."""
    generator = torch.Generator().manual_seed(seed)
    centres = torch.randn(4, dim, generator=generator)
    which = torch.randint(4, (count,), generator=generator)
    noise = torch.randn(count, dim, generator=generator)
    return (centres[which] + 0.1 * noise) * (0.5 + torch.rand(count, 1, generator=generator))


def test_training_brings_reconstructions_nearer() -> None:
    rows, means = clusters(), []
    for epochs in (0, 2, 12):
        fitted = fit_autoencoder(rows, replace(SMALL, epochs=epochs))
        codes = fitted.encode(rows)
        decoded = fitted.decode(codes)
        assert codes.shape == (120, 3)
        assert not codes.requires_grad
        for each in (codes, decoded):
            assert torch.allclose(each.norm(dim=1), torch.ones(120))
        means.append(float(torch.nn.functional.cosine_similarity(decoded, rows, dim=1).mean()))
    assert means == sorted(means)
    assert means[-1] > 0.95


def test_the_layers_are_those_of_langsplat() -> None:
    fitted = fit_autoencoder(torch.randn(3, 512), AutoencoderSettings(epochs=0))

    def sizes(part: nn.Sequential) -> list[int]:
        return [layer.out_features for layer in part if isinstance(layer, nn.Linear)]

    assert sizes(fitted.encoder) == [256, 128, 64, 32, 3]
    assert sizes(fitted.decoder) == [16, 32, 64, 128, 256, 256, 512]
    kinds = [[type(layer).__name__ for layer in part] for part in (fitted.encoder, fitted.decoder)]
    assert kinds == [["Linear", *["BatchNorm1d", "ReLU", "Linear"] * 4], ["Linear", *["ReLU", "Linear"] * 6]]
    assert (LANGSPLAT.epochs, LANGSPLAT.batch, LANGSPLAT.learning_rate) == (100, 64, 7e-4)


def test_the_loss_is_that_of_langsplat() -> None:
    found, rows = torch.tensor([[1.0, 0.0], [0.0, 1.0]]), torch.tensor([[1.0, 0.0], [1.0, 0.0]])
    assert float(reconstruction_loss(found, rows)) == pytest.approx(2 / 4 + 1e-3 * 0.5)


def test_the_same_seed_gives_the_same_network_and_leaves_the_random_state_alone() -> None:
    rows = clusters()
    before = torch.random.get_rng_state()
    first, same = (fit_autoencoder(rows, SMALL, seed=3).encode(rows) for _ in range(2))
    assert torch.equal(before, torch.random.get_rng_state())
    assert torch.equal(first, same)
    assert not torch.equal(first, fit_autoencoder(rows, SMALL, seed=4).encode(rows))


def test_rows_of_norm_zero_are_left_out() -> None:
    rows = clusters()
    with_zeros = torch.cat([torch.zeros(1, 12), rows, torch.zeros(2, 12)])
    plain, fitted = fit_autoencoder(rows, SMALL), fit_autoencoder(with_zeros, SMALL)
    codes = fitted.encode(with_zeros)
    assert torch.equal(codes[1:-2], plain.encode(rows))
    assert not codes[[0, -2, -1]].any()
    assert not fitted.decode(codes)[[0, -2, -1]].any()
    for nothing in (torch.zeros(0, 5), torch.zeros(4, 5)):
        codes = fit_autoencoder(nothing, SMALL).encode(nothing)
        assert codes.shape == (len(nothing), 3)
        assert not codes.any()


@pytest.mark.parametrize("count", [1, 2, 15, 16, 17, 33])
def test_any_number_of_rows(count: int) -> None:
    seen: list[tuple[str, int, int]] = []
    rows = clusters(count)
    fitted = fit_autoencoder(rows, SMALL, progress=lambda *call: seen.append(call))
    assert torch.isfinite(fitted.encode(rows)).all()
    steps = 12 * {33: 2}.get(count, 1)  # a row left over joins the batch before it
    assert seen == [("autoencoder", done, steps) for done in range(steps + 1)]


def test_bad_input_is_refused() -> None:
    for rows in (torch.zeros(3), torch.zeros(3, 4, dtype=torch.long), torch.tensor([[1.0, float("nan")]])):
        with refuses():
            fit_autoencoder(rows, SMALL)
    with refuses():
        fit_autoencoder(torch.ones(3, 4), replace(SMALL, epochs=-1))
