"""Tasks and messages at random, and a connection of who asks."""
