"""Commands about a cluster, whether or not a platform is on it."""
