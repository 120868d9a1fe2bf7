"""What is drawn where a terminal is there: tables, bars, and a part of the screen that is drawn anew."""
