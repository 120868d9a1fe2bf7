"""Suites: what tries a chart in a test namespace, and the process that runs them."""
