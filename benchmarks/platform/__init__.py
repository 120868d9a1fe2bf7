"""What needs a whole platform on a cluster of its own: publication, plans applied, encounters."""
