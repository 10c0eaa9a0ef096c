"""TOML files: read with the place of every entry, checked against schemas."""
