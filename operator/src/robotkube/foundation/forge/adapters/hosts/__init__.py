"""Forges over their HTTP APIs: the platform runs Gitea; GitHub and GitLab are for fleets that have one of them."""
