"""Clusters to run RobotKube on; the provider `embedded` makes one of processes on this machine, without Docker."""
