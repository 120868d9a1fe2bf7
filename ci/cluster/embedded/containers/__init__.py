"""Containers that nobody of the cluster started, beside the kubelets of its nodes."""
