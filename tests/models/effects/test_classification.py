"""Confusion matrices: what is claimed as often as a row says, and how sure a claim is."""

from __future__ import annotations

import numpy as np
import pytest
from support.significance import assert_chance, assert_sum

from plotfeed.models.effects.classification import Confusion

MATRIX = Confusion(
    claims=("drone", "bird", "aircraft"),
    true_classes=("drone", "bird"),
    rows=((0.8, 0.15, 0.05), (0.3, 0.7, 0.0)),
)


@pytest.mark.parametrize("row", [0, 1])
def test_claims_are_as_frequent_as_their_row_says(row: int) -> None:
    n = 20_000
    true = np.full(n, MATRIX.true_classes[row], np.object_)
    kinds, _ = MATRIX.claimed(true, np.random.default_rng(row))
    for claim, share in zip(MATRIX.claims, MATRIX.rows[row], strict=True):
        said = float((kinds == claim).sum())
        if share == 0:
            assert said == 0
        else:
            assert_sum(said, n * share, n * share * (1 - share), claim)


def test_a_claim_is_as_sure_as_it_is_right_of_classes_that_are_as_frequent() -> None:
    n = 40_000
    true = np.array(MATRIX.true_classes * (n // 2), np.object_)
    kinds, probability = MATRIX.claimed(true, np.random.default_rng(3))
    for claim, expected in (("drone", 0.8 / 1.1), ("bird", 0.7 / 0.85), ("aircraft", 0.0)):
        mine = kinds == claim
        np.testing.assert_allclose(probability[mine], expected)
        right = float((true[mine] == claim).sum())
        spread = mine.sum() * expected * (1 - expected)
        assert right == 0 if expected == 0 else True
        if expected:
            assert_sum(right, mine.sum() * expected, spread, claim)


def test_what_the_matrix_does_not_name_is_called_nothing_or_what_otherwise_says() -> None:
    true = np.array(["balloon", None, ""] * 500, np.object_)
    kinds, probability = MATRIX.claimed(true, np.random.default_rng(4))
    assert set(kinds) == {""}
    assert np.isnan(probability).all()
    named = Confusion(
        claims=MATRIX.claims,
        true_classes=MATRIX.true_classes,
        rows=MATRIX.rows,
        otherwise=(0.0, 1.0, 0.0),
    )
    assert set(named.claimed(true, np.random.default_rng(4))[0]) == {"bird"}


def test_rows_whose_sum_rounds_below_one_never_claim_what_there_is_not() -> None:
    thirds = Confusion(
        claims=("a", "b", "c"), true_classes=("a",), rows=((1 / 3, 1 / 3, 1 / 3 - 1e-9),)
    )

    class Last:
        def random(self, size: tuple[int, ...]) -> np.ndarray:
            return np.full(size, np.nextafter(1.0, 0.0))

    rng: np.random.Generator = Last()  # type: ignore[assignment]
    assert thirds.claimed(np.array(["a"], np.object_), rng)[0].tolist() == ["c"]


def test_claims_of_one_target_are_independent_of_each_other() -> None:
    true = np.full(20_000, "drone", np.object_)
    wrong = MATRIX.claimed(true, np.random.default_rng(5))[0] != "drone"
    both = (wrong[1:] & wrong[:-1]).mean()
    assert_chance(float(abs(both - 0.04) < 0.008))
