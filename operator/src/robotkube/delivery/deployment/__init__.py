"""The deployment repository: files of releases, commit messages, policies, history of main."""
