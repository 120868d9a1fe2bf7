"""Runs a scenario on a running platform, measures it from its data, and reports."""
