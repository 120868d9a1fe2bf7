"""`make test`: the groups of tests, each in processes of its own, and their results."""
