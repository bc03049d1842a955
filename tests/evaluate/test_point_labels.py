"""Classes of points: counting and scores against numbers worked out by hand, and the class a Gaussian is given."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from evaluate.known_methods import NothingRendered
from messages import refuses
from scoup.query import TextVectors
from scoup_lab.evaluate.protocols.points import (
    NO_CLASS,
    class_accuracies,
    class_ious,
    class_mean,
    class_totals,
    confusion_matrix,
    label_gaussians,
)

#                    three of class 0      two of 1  one of 3   two that do not count
TRUTH = torch.tensor([0, 0, 0, 1, 1, 3, NO_CLASS, NO_CLASS])
GIVEN = torch.tensor([0, 0, 1, 1, NO_CLASS, 2, 0, 3])


def test_points_are_counted_by_hand() -> None:
    matrix = confusion_matrix(TRUTH, GIVEN, 4)
    assert matrix.tolist() == [[2, 1, 0, 0, 0], [0, 1, 0, 0, 1], [0, 0, 0, 0, 0], [0, 0, 1, 0, 0]]
    # found, truly there, given; the two points that do not count are in none of them
    assert class_totals(matrix).tolist() == [[2, 1, 0, 0], [3, 2, 0, 1], [2, 2, 1, 0]]


def test_scores_by_hand() -> None:
    totals = class_totals(confusion_matrix(TRUTH, GIVEN, 4))
    # 0: 2 of 3 + 2 - 2; 1: 1 of 2 + 2 - 1; 2: not in the truth; 3: 0 of 1
    assert class_ious(totals).tolist() == pytest.approx([2 / 3, 1 / 3, float("nan"), 0], nan_ok=True)
    assert class_accuracies(totals).tolist() == pytest.approx([2 / 3, 1 / 2, float("nan"), 0], nan_ok=True)
    assert float(class_mean(class_ious(totals))) == pytest.approx(1 / 3)
    assert float(class_mean(class_accuracies(totals))) == pytest.approx((2 / 3 + 1 / 2) / 3)


def test_scores_of_several_totals_at_once() -> None:
    matrices = [confusion_matrix(TRUTH, given, 4) for given in (GIVEN, TRUTH)]
    both = torch.stack([class_totals(matrix) for matrix in matrices])
    means = [float(class_mean(class_ious(totals))) for totals in both]
    assert class_mean(class_ious(both)).tolist() == pytest.approx(means)
    assert class_ious(both)[0].nan_to_num(-1).equal(class_ious(both[0]).nan_to_num(-1))


def test_numbers_that_are_no_class_are_refused() -> None:
    with refuses():
        confusion_matrix(TRUTH, torch.full_like(TRUTH, 4).clamp(min=0).index_fill(0, torch.tensor([0]), 0), 4)
    with refuses():
        confusion_matrix(TRUTH, GIVEN[:3], 4)


@dataclass(frozen=True)
class Known(NothingRendered):
    """A fitted method of known relevancy [S, Q, N]."""

    known: Tensor
    codes: Tensor

    def gaussian_relevancy(self, queries: Tensor, canonical: Tensor) -> Tensor:
        return self.known[:, queries[:, 0].long()]

    def coded(self) -> Tensor:
        return self.codes


def known(n_texts: int, relevancy: Tensor, codes: Tensor) -> tuple[Known, TextVectors, list[str]]:
    texts = [str(number) for number in range(n_texts)]
    numbers = torch.arange(n_texts).float()[:, None]
    return Known(relevancy, codes), TextVectors(tuple(texts), numbers, numbers, numbers), texts


def test_a_gaussian_takes_the_most_relevant_class_of_all_its_levels() -> None:
    relevancy = torch.tensor(
        [
            #  Gaussians: 0     1     2     3
            [[0.30, 0.90, 0.20, 0.6], [0.40, 0.10, 0.20, 0.6]],  # level 0, classes 0 and 1
            [[0.35, 0.20, 0.50, 0.6], [0.20, 0.95, 0.50, 0.6]],  # level 1
        ]
    )
    # Gaussian 2 has no code at level 1, where its relevancy is a draw; Gaussian 3 has none at all.
    codes = torch.tensor([[True, True, True, False], [True, True, False, False]])
    fitted, vectors, texts = known(2, relevancy, codes)
    assert label_gaussians(fitted, vectors, texts).tolist() == [1, 1, 0, NO_CLASS]
    assert label_gaussians(fitted, vectors, texts, level=1).tolist() == [0, 1, NO_CLASS, NO_CLASS]
    with refuses():
        label_gaussians(fitted, vectors, texts, level=2)


def test_many_classes_are_queried_in_parts() -> None:
    generator = torch.Generator().manual_seed(0)
    relevancy = torch.rand(3, 50, 40, generator=generator)
    fitted, vectors, texts = known(50, relevancy, torch.ones(3, 40, dtype=torch.bool))
    assert label_gaussians(fitted, vectors, texts).equal(relevancy.amax(0).argmax(0))
