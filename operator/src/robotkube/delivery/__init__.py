"""What runs: from a task to a commit on main, and what becomes of it."""
