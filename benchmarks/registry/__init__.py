"""The registry: validation, verified catalogues, admission by what they list."""
