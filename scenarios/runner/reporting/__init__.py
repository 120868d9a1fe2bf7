"""What people see of a run: moments while it goes on, then report.json and report.html."""
