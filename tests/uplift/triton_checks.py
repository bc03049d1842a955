"""What must hold for the vote on a GPU, on any device: on "cpu" the kernel is interpreted."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import pytest
import torch

from scoup.base import InputError
from uplift.random_votes import Sizes, buckets_of, check_rounds, damaged, random_vote


def check_vote(sizes: Sizes, keep: int, seed: int, device: str) -> None:
    from scoup.uplift.vote_backends.triton import Vote

    check_rounds(Vote, sizes, keep, seed, device)


def check_few_at_a_time(device: str) -> None:
    """However many entries or sums are on the device at once, the result is the same to the last bit."""
    from scoup.uplift.vote_backends import triton as vote_triton

    arguments = random_vote(Sizes(258, 1, 1, 5, 2, 60), 4)
    buckets = buckets_of(arguments)
    limits: list[tuple[dict[str, Any], list[range]]] = [
        ({"MOST_ENTRIES": 100}, [range(2)]),
        ({"MOST_ENTRIES": 1}, [range(1), range(1, 2)]),
        ({"MOST_SUMS": 1}, [range(1), range(1, 2)]),
        ({"MOST_KNOWN": 1, "MOST_KEPT": 1}, [range(2)]),
    ]
    found = []
    for most, chunks in limits:
        with patch.multiple(vote_triton, **most):
            prepared = vote_triton.Vote(**arguments, device=torch.device(device))
            assert list(prepared.chunks(buckets, 2)) == chunks
            found.append(prepared.round(2, None, False, buckets))
    assert bool(found[0][1].any())
    for others in found[1:]:
        assert all(torch.equal(one, other) for one, other in zip(others, found[0], strict=True))


def check_nothing_to_add(device: str) -> None:
    """No share of the buckets, and Gaussians that no view has."""
    from scoup.uplift.vote_backends.triton import Vote

    arguments = random_vote(Sizes(40, 0, 2), 4)
    prepared = Vote(**arguments, device=torch.device(device))
    assert prepared.round(3, None, True, range(1, 1))[0].shape == (0, 2, 3)
    assert not bool(prepared.round(3, None, True, range(1))[1].any())


def check_damage(device: str) -> None:
    from scoup.uplift.vote_backends.triton import Vote

    for arguments in damaged(random_vote(Sizes(n_gaussians=30, levels=1), 2)).values():
        with pytest.raises(InputError, match="damaged"):
            Vote(**arguments, device=torch.device(device)).round(4, None, False, buckets_of(arguments))


SMALL_CHECKS = (check_few_at_a_time, check_nothing_to_add, check_damage)
