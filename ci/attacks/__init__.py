"""Attacks on the platform's promises, and what refuses each at which place."""
