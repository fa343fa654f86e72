"""Powers of monomials, and numbers that are spread evenly."""

import numpy as np

from lagsplat.integer_lists import choose_evenly, list_powers


def test_numbers_are_chosen_evenly_with_both_ends() -> None:
    np.testing.assert_array_equal(choose_evenly(5, 9), np.arange(5))
    chosen = choose_evenly(1000, 11)
    assert (chosen[0], chosen[-1], len(chosen)) == (0, 999, 11)


def test_powers_go_by_degree() -> None:
    expected = [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]]
    np.testing.assert_array_equal(list_powers(2, lowest=0, highest=2), expected)
    assert list_powers(2, lowest=2, highest=1).shape == (0, 2)
