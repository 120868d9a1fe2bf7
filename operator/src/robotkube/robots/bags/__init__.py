"""Bags: reading and writing them, and the player."""
