"""Measurements of the parts whose cost decides whether the scenario fits on two cores."""
