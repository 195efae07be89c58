"""Small linear problems against singular values: the shortest, the least, and what is dependent."""

from __future__ import annotations

import numpy as np
import pytest

from pupper_analysis.statics.small_least_squares import (
    solve_constrained,
    solve_least_squares,
    solve_orthogonal,
)


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(3)


def test_the_shortest_solution_and_what_rows_take_to_zero(random: np.random.Generator) -> None:
    rows, right = random.normal(size=(3, 7)), random.normal(size=3)
    found = solve_orthogonal(rows, right)
    assert found is not None
    shortest, null = found
    np.testing.assert_allclose(shortest, np.linalg.pinv(rows) @ right, atol=1e-12)
    np.testing.assert_allclose(rows @ null, 0, atol=1e-12)
    np.testing.assert_allclose(null.T @ null, np.eye(4), atol=1e-12)


def test_rows_that_depend_on_each_other_are_noticed(random: np.random.Generator) -> None:
    rows = random.normal(size=(3, 7))
    rows[2] = rows[0] - 2 * rows[1]
    assert solve_orthogonal(rows, random.normal(size=3)) is None
    assert solve_constrained(np.eye(7), np.zeros(7), rows, random.normal(size=3)) is None
    assert solve_orthogonal(random.normal(size=(7, 7)), np.ones(7)) is None  # nothing is left free


def test_least_squares_with_conditions(random: np.random.Generator) -> None:
    """By the conditions of Karush, Kuhn and Tucker."""
    cost, target = random.normal(size=(6, 5)), random.normal(size=6)
    rows, right = random.normal(size=(2, 5)), random.normal(size=2)
    found = solve_constrained(cost, target, rows, right)
    assert found is not None
    np.testing.assert_allclose(rows @ found, right, atol=1e-12)
    gradient = cost.T @ (cost @ found - target)
    prices = np.linalg.lstsq(rows.T, gradient)[0]
    np.testing.assert_allclose(rows.T @ prices, gradient, atol=1e-12)
    assert solve_constrained(cost[:2], target[:2], rows, right) is None  # several are as good


@pytest.mark.parametrize("rank", [4, 2])
def test_least_squares_are_numpys(random: np.random.Generator, rank: int) -> None:
    matrix = random.normal(size=(6, rank)) @ random.normal(size=(rank, 4))
    right = random.normal(size=6)
    expected = np.linalg.pinv(matrix, rcond=1e-10) @ right
    np.testing.assert_allclose(solve_least_squares(matrix, right), expected, atol=1e-10)
    np.testing.assert_allclose(
        solve_least_squares(matrix.T, right[:4]),
        np.linalg.pinv(matrix.T, rcond=1e-10) @ right[:4],
        atol=1e-10,
    )
