"""A console's process that is none: a fleet that drives on paper, served as the contract of the page has it."""
