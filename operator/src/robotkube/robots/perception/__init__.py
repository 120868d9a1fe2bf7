"""Perception services: detection of objects in point clouds, tracking."""
