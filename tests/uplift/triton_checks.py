"""What must hold for the vote on a GPU, on any device: on "cpu" the kernel is interpreted."""

from __future__ import annotations

import pytest
import torch

from scoup.base.errors import InputError
from uplift.ballots import Sizes, buckets_of, check_rounds, damaged, random_ballot


def check_vote(sizes: Sizes, keep: int, seed: int, device: str) -> None:
    from scoup.uplift.vote_backends.triton import Ballot

    check_rounds(Ballot, sizes, keep, seed, device)


def check_few_at_a_time(device: str) -> None:
    """However many entries or sums are on the device at once, the result is the same to the last bit."""
    from scoup.uplift.vote_backends import triton as vote_triton

    arguments = random_ballot(Sizes(258, 1, 1, 5, 2, 60), 4)
    buckets = buckets_of(arguments)
    ballot = vote_triton.Ballot(**arguments, device=torch.device(device))
    found = []
    for name, most, chunks in (
        ("MOST_BUCKETS", 256, [range(2)]),
        ("MOST_BUCKETS", 1, [range(1), range(1, 2)]),
        ("MOST_ENTRIES", 1, [range(1), range(1, 2)]),
        ("MOST_SUMS", 1, [range(1), range(1, 2)]),
    ):
        before = getattr(vote_triton, name)
        setattr(vote_triton, name, most)
        try:
            assert list(ballot._chunks(buckets)) == chunks
            found.append(ballot.round(2, None, False, buckets))
        finally:
            setattr(vote_triton, name, before)
    assert bool(found[0][1].any())
    for others in found[1:]:
        assert all(torch.equal(one, other) for one, other in zip(others, found[0], strict=True))


def check_nothing_to_add(device: str) -> None:
    """No share of the buckets, and Gaussians that no view has."""
    from scoup.uplift.vote_backends.triton import Ballot

    arguments = random_ballot(Sizes(40, 0, 2), 4)
    ballot = Ballot(**arguments, device=torch.device(device))
    assert ballot.round(3, None, True, range(1, 1))[0].shape == (0, 2, 3)
    assert not bool(ballot.round(3, None, True, range(1))[1].any())


def check_damage(device: str) -> None:
    from scoup.uplift.vote_backends.triton import Ballot

    for arguments in damaged(random_ballot(Sizes(n_gaussians=30, levels=1), 2)).values():
        with pytest.raises(InputError, match="damaged"):
            Ballot(**arguments, device=torch.device(device)).round(4, None, False, buckets_of(arguments))
