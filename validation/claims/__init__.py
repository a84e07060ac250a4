"""The paper's quantitative statements, computed: ``inputs/paper/claims.toml`` lists them with their functions here."""
