"""What a platform does, as it does it: moments as lines, and on a terminal a view of the fleet."""
