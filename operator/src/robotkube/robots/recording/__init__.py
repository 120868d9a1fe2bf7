"""Recordings: large messages in segments, small ones in the database, an audit of what is missing."""
