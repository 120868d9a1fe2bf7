"""`robotkube registry ...`."""
