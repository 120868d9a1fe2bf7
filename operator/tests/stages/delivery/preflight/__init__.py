"""What the preflight knows of a cluster and of its Nodes."""
