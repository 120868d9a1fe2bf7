"""What is seen of a run: watched while it goes on, collected when it has ended."""
