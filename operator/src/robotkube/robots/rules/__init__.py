"""Rules: what is an event, when it begins and when it ends."""
