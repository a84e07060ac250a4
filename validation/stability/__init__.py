"""Where engines break, whether that is predicted, and what survives: limits, extremes, long runs, rounding.

``limits`` measures the largest stable steps, ``scenes`` says on which chains, ``extremes`` runs what is at the edge,
``long_runs`` goes past the horizon of pointwise agreement, ``rounding`` measures what heights cost, ``maps`` draws,
``words`` says it, ``section`` tells the report.
"""
