"""RobotKube: events in robots' data become audited deployments on Kubernetes."""

VERSION = "0.1.0"
"""Of this program; that of the Python package and of the platform's chart."""
