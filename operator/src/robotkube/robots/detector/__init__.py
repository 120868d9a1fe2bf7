"""The event detector: live topics, buffers, rules, reactions, in one process."""
