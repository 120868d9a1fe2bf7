"""Rights at the broker: an agent writes below its own places, and reads what links on main say."""
