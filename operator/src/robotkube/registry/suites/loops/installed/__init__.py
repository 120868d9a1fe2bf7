"""What the suite `install` does to a chart that runs: the soak, its memory, and changed settings."""
