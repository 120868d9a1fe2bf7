"""The console: what the platform knows of the fleet, of why it is so, and who asked, for a page that stays open."""
