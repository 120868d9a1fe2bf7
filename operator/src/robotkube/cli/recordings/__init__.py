"""`robotkube recording ...`."""
