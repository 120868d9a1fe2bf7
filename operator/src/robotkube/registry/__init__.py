"""What may run: charts, the evidence for them, and how they get into the catalogue."""
