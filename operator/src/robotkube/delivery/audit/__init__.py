"""The audit: what ran where, for whom and on what evidence, and what was manipulated, from Git and registry alone."""
