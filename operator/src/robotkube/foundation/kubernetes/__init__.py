"""The Kubernetes API: requests, watches, a Lease, identity of objects."""
