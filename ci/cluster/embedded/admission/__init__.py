"""Admission from files on the host, which follow the catalogue."""
