"""What an inspection sees, and where it writes."""
