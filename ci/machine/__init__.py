"""This machine: what it has, what it lacks for what is built and started here, and how it gets that."""
