"""Quantitative statements of the paper, computed; ``inputs/paper/claims.toml`` names the function of each."""
