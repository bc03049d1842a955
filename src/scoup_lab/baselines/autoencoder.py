"""LangSplat's autoencoder: three numbers per region, and a network that decodes them to an embedding.

What sparse codes are compared with in method.md. A splat of LangSplat stores the three numbers for each Gaussian, and
a picture of it three for each pixel; every query needs the network, which is trained for each scene.

Followed from LangSplat's public code: layers 512-256-128-64-32-3 and 3-16-32-64-128-256-256-512, batch normalisation
and ReLU between the layers of the encoder, ReLU alone between those of the decoder; the three numbers and the result
scaled to unit norm; loss = mean squared difference of all entries + 0.001 (1 - cosine); Adam, learning rate 7e-4 as in
their script, 100 epochs, batches of 64; of the last four epochs the network that does best is kept. As there, quality
is that on the rows learned from.

Where this departs from it:

* The cosine of the loss is between an embedding and its reconstruction. Theirs is taken along the batch, for each of
  the 512 numbers. For unit vectors both terms are multiples of 1 - cosine, so the second hardly matters.
* The last four epochs compete, however many there are; theirs are those from the 97th on.
* One row left over at the end of an epoch joins the batch before it: a batch of one has no variance, and
  stops their code with an error.
* Nothing is logged and autograd's anomaly detection is off, so steps cost less than theirs on the same machine.
* Any D, not only 512. Rows of norm zero are left out, and get three zeros.
"""

from __future__ import annotations

import copy
import itertools
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from scoup.base import InputError, Progress, no_progress
from scoup.scene import normalise_embeddings

COSINE_WEIGHT = 1e-3
KEPT_OF_LAST = 4  # epochs
_BLOCK_ROWS = 8192  # encoded or decoded together


@dataclass(frozen=True)
class AutoencoderSettings:
    """Sizes and schedule; the defaults are LangSplat's."""

    epochs: int = 100  # how often every row is seen
    batch: int = 64  # rows of a step, 2 or more
    learning_rate: float = 7e-4  # of Adam
    # outputs of the encoder's layers; the last is the size of the code
    encoder: tuple[int, ...] = (256, 128, 64, 32, 3)
    # outputs of the decoder's layers, but for the last, which has D
    decoder: tuple[int, ...] = (16, 32, 64, 128, 256, 256)

    def departure(self) -> str:
        """Return how the schedule departs from the published one; "" if it does not."""
        return "" if self.epochs == LANGSPLAT.epochs else f"{self.epochs} of {LANGSPLAT.epochs} epochs"


LANGSPLAT = AutoencoderSettings()


@dataclass(frozen=True, eq=False)
class Autoencoder:
    """A trained autoencoder."""

    # unit rows [R, D] to codes [R, C] that are not yet of unit norm; in evaluation mode
    encoder: nn.Sequential
    decoder: nn.Sequential  # unit codes [R, C] to [R, D], not yet of unit norm
    dim: int  # D
    code_size: int  # C, 3 in LangSplat

    def encode(self, rows: Tensor) -> Tensor:
        """Return [R, C] float32 unit codes of ``rows`` [R, D] of any norm; zeros for rows of norm zero."""
        return _apply(self.encoder, normalise_embeddings(rows), self.code_size)

    def decode(self, codes: Tensor) -> Tensor:
        """Return [R, D] float32 unit rows of ``codes`` [R, C] of any norm; zeros for codes of norm zero."""
        return _apply(self.decoder, normalise_embeddings(codes), self.dim)


def fit_autoencoder(
    embeddings: Tensor,  # [R, D]
    settings: AutoencoderSettings = LANGSPLAT,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Autoencoder:
    """Train LangSplat's autoencoder on embeddings, on their device.

    The same input, seed and number of threads give the same network. The random state of torch is left alone.

    ``embeddings``: [R, D] floating point, one row per region, any norm; rows of norm zero are left out;
    ``settings``: see ``AutoencoderSettings``.
    """
    if settings.epochs < 0:
        raise InputError(f"epochs must not be negative, got {settings.epochs}")
    rows = normalise_embeddings(embeddings)
    dim, code_size = rows.shape[1], settings.encoder[-1]
    rows = rows[rows.any(1)]
    random = torch.Generator().manual_seed(seed)  # on the CPU, so that every device draws the same
    network = nn.Sequential(
        _layers((dim, *settings.encoder), random, normalised=True),
        _layers((code_size, *settings.decoder, dim), random, normalised=False),
    ).to(rows.device)
    if len(rows):
        network = _trained(network, rows, settings, random, progress)
    return Autoencoder(*_parts(network.eval()), dim, code_size)


def reconstruction_loss(outputs: Tensor, rows: Tensor) -> Tensor:
    """Return the loss of LangSplat between reconstructions and rows, both [B, D]."""
    cosine = torch.nn.functional.cosine_similarity(outputs, rows, dim=1)
    return (outputs - rows).square().mean() + COSINE_WEIGHT * (1 - cosine.mean())


def _layers(sizes: tuple[int, ...], random: torch.Generator, normalised: bool) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(sizes):
        if layers:
            layers += [nn.BatchNorm1d(inputs)] if normalised else []
            layers.append(nn.ReLU())
        # torch's own start draws from the global random state; this is the same distribution.
        linear = nn.utils.skip_init(nn.Linear, inputs, outputs)
        for parameter in linear.parameters():
            nn.init.uniform_(parameter, -(inputs**-0.5), inputs**-0.5, generator=random)
        layers.append(linear)
    return nn.Sequential(*layers)


def _trained(
    network: nn.Sequential,
    rows: Tensor,
    settings: AutoencoderSettings,
    random: torch.Generator,
    progress: Progress,
) -> nn.Sequential:
    """Return the checkpoint of the best of the last epochs."""
    optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    total = settings.epochs * len(_batches(torch.arange(len(rows)), settings.batch))
    best, chosen_network, done = -2.0, network, 0
    progress("autoencoder", 0, total)
    for epoch in range(settings.epochs):
        network.train()
        order = torch.randperm(len(rows), generator=random).to(rows.device)
        for chosen in _batches(order, settings.batch):
            batch = rows[chosen]
            loss = reconstruction_loss(_reconstructed(network, batch), batch)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            done += 1
            progress("autoencoder", done, total)
        if epoch >= settings.epochs - KEPT_OF_LAST:
            cosine = float(_cosines(network.eval(), rows).double().mean())
            if cosine > best:
                best, chosen_network = cosine, copy.deepcopy(network)
    return chosen_network


def _batches(order: Tensor, size: int) -> list[Tensor]:
    """Return parts of ``order`` [R], none of one row only."""
    if len(order) == 1:
        return [order.repeat(2)]
    batches = list(order.split(size))
    if len(batches[-1]) == 1:
        batches[-2:] = [torch.cat(batches[-2:])]
    return batches


def _parts(network: nn.Sequential) -> tuple[nn.Sequential, nn.Sequential]:
    encoder, decoder = network
    assert isinstance(encoder, nn.Sequential)
    assert isinstance(decoder, nn.Sequential)
    return encoder, decoder


def _reconstructed(network: nn.Sequential, rows: Tensor) -> Tensor:
    for layers in network:
        rows = torch.nn.functional.normalize(layers(rows), dim=1)
    return rows


@torch.no_grad()
def _cosines(network: nn.Sequential, rows: Tensor) -> Tensor:
    """Return [R] cosine between unit rows [R, D] and their reconstructions."""
    blocks = [(_reconstructed(network, block) * block).sum(1) for block in rows.split(_BLOCK_ROWS)]
    return torch.cat(blocks)


@torch.no_grad()
def _apply(network: nn.Sequential, rows: Tensor, outputs: int) -> Tensor:
    """Return [R, outputs] of unit norm; zeros for rows of norm zero."""
    parameter = next(network.parameters())
    result = torch.zeros(len(rows), outputs, device=parameter.device)
    for start in range(0, len(rows), _BLOCK_ROWS):
        block = rows[start : start + _BLOCK_ROWS].to(parameter.device)
        filled = block.any(1)
        made = torch.nn.functional.normalize(network(block), dim=1)
        result[start : start + _BLOCK_ROWS] = torch.where(filled[:, None], made, 0.0)
    return result.to(rows.device)
