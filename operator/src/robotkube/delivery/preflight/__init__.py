"""Preflight: whether a cluster can take the platform's chart, or go on with it, by reading and by a probe."""
