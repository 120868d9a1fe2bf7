"""Executable stories: what a scenario is (`definition`), its data (`generator`), its run and report (`runner`)."""
