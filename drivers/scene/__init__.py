"""TOML -> Scene: scene files, read, validated and converted to SI units."""
