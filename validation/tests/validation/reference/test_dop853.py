"""Compiled formulas of DOP853."""

import numpy as np
from scipy.integrate import DOP853

from validation.reference.dop853 import DENSE, END, FIFTH, FORMULAS, ROWS, STAGES, THIRD, C, weigh


def test_coefficients_are_those_of_scipy() -> None:
    np.testing.assert_array_equal(C, [*DOP853.C, 1.0, *DOP853.C_EXTRA])
    np.testing.assert_array_equal(FORMULAS[:STAGES, :STAGES], DOP853.A)
    np.testing.assert_array_equal(FORMULAS[END, :STAGES], DOP853.B)
    np.testing.assert_array_equal(FORMULAS[END + 1 : ROWS], DOP853.A_EXTRA)
    np.testing.assert_array_equal(FORMULAS[[FIFTH, THIRD], : STAGES + 1], [DOP853.E5, DOP853.E3])
    np.testing.assert_array_equal(FORMULAS[DENSE:], DOP853.D)


def test_slopes_without_weight_are_ignored_even_if_not_finite() -> None:
    """A step that overflows leaves slopes that are not finite; the step is repeated with a smaller size."""
    slopes = np.random.default_rng(1).normal(size=(FORMULAS.shape[1], 7))
    for formula, weights in enumerate(FORMULAS):
        if weights.any():
            unused, result = np.where(weights[:, np.newaxis] == 0, np.nan, slopes), np.empty(7)
            weigh(formula, 0.5, unused, result)
            np.testing.assert_allclose(result, 0.5 * weights @ slopes, rtol=1e-13, atol=1e-13)
