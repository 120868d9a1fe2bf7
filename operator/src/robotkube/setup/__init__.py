"""Setting a platform up after its installation, and taking it down before it is uninstalled."""
