"""What makes a story happen: needs and readiness of the cluster, configuration, players, steps, cables."""
