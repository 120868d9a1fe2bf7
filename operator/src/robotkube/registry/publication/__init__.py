"""Publication: a submission is checked, tried, signed and merged into the catalogue."""
