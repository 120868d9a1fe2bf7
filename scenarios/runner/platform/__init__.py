"""The platform as a run reaches it: its API server, forge and broker, agents' pods, the deployment repository."""
