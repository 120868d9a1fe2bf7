"""The kind of cluster that is made of this machine's own processes."""
