"""What is done about an event: a task, a message to a receiver, an installed reaction."""
