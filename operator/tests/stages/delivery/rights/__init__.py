"""The broker of rights: real ones, what keeps them to main, and who is there."""
