"""Bundles: the platform in one OCI image layout, brought to a registry or into a container runtime by digest."""
