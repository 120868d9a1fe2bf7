"""The life of a process: settings, signals, health and webhooks, watched configuration, fencing."""
