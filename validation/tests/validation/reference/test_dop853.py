"""The formulas of DOP853 as they are compiled."""

import numpy as np

from validation.reference.dop853 import FORMULAS, weigh


def test_slopes_without_a_weight_take_no_part_finite_or_not() -> None:
    """A step that overflowed and is repeated shorter leaves slopes that are not finite."""
    slopes = np.random.default_rng(1).normal(size=(FORMULAS.shape[1], 7))
    for formula, weights in enumerate(FORMULAS):
        if weights.any():
            unused, result = np.where(weights[:, np.newaxis] == 0, np.nan, slopes), np.empty(7)
            weigh(formula, 0.5, unused, result)
            np.testing.assert_allclose(result, 0.5 * weights @ slopes, rtol=1e-13, atol=1e-13)
