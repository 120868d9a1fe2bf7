"""Preflight: whether a cluster can take the platform's chart, or go on with it; everything is read, nothing changed."""
