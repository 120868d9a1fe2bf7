"""The application manager: what tasks ask for becomes releases, by pull request."""
