"""Clusters by kind (https://kind.sigs.k8s.io): each Node is a container of Docker or podman, whichever kind finds."""
