"""The command `robotkube`."""
