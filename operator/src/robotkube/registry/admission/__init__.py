"""Admission: what the API server lets into the cluster, as policies over a list of what was verified."""
