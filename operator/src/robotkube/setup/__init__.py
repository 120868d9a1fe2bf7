"""Setting a platform up after its installation, trying it, and taking it down before it is uninstalled."""
