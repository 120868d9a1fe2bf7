"""A network as vehicles have it: delay, jitter, rate and loss of an agent's cable, and holes in its coverage."""
