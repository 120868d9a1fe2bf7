"""`make check`: formatting, lint, types, import contracts, the repository's own rules, links, the console's page."""
