"""Compiled formulas of DOP853."""

import numpy as np

from validation.reference.dop853 import FORMULAS, weigh


def test_slopes_without_weight_are_ignored_even_if_not_finite() -> None:
    """A step that overflows leaves slopes that are not finite; the step is repeated with a smaller size."""
    slopes = np.random.default_rng(1).normal(size=(FORMULAS.shape[1], 7))
    for formula, weights in enumerate(FORMULAS):
        if weights.any():
            unused, result = np.where(weights[:, np.newaxis] == 0, np.nan, slopes), np.empty(7)
            weigh(formula, 0.5, unused, result)
            np.testing.assert_allclose(result, 0.5 * weights @ slopes, rtol=1e-13, atol=1e-13)
