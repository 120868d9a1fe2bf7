"""What a cluster is on its host: processes, mounts, and records of what was done to the machine."""
