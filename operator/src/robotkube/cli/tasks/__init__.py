"""`robotkube task ...`."""
