"""From a task to main: planning, decisions of the application manager, merges of the gate."""
