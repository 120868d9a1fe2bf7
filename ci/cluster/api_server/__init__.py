"""A cluster, read and written by its API server."""
