"""Bridge, cables and addresses of a cluster, of its nodes and pods."""
