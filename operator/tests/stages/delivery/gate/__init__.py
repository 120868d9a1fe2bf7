"""The gate: its settings, people who sign, trials of applications."""
