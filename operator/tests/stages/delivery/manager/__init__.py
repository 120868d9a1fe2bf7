"""The manager: in memory, as a process, on a real forge; what it places, and under load."""
