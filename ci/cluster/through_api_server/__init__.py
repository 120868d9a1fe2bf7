"""Clusters of which this machine surely reaches the API server alone: forwards to Services, and files by pods."""
