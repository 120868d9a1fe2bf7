"""Recordings as bags and data sets, with labels."""
