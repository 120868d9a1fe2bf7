"""`robotkube image ...`."""
