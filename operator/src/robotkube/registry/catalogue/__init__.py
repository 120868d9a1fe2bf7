"""The catalogue: applications and chart versions, validation, search, the graph of upgrades."""
