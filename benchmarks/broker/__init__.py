"""What goes through the broker between agents: links, the rights to them, encryption."""
