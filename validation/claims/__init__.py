"""The paper's quantitative statements, computed.

``inputs/paper/claims.toml`` lists them, and a function here computes each. The modules hold the functions by claim
in their ``COMPUTED``; ``judge`` judges and writes, ``section`` is for the report.
"""
