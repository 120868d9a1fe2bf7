"""Stand-ins in memory for tests and benchmarks."""
