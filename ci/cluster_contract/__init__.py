"""What every kind of cluster offers and takes: its provider, the nodes to have, the conditions of their cables."""
