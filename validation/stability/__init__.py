"""Where engines break, whether that is predicted, and what survives: limits, extremes, long runs, rounding."""
