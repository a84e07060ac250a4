"""TOML -> Scene: what a physicist writes, validated, in SI units."""
