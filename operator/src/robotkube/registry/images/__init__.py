"""Images: built, made reproducible, and described by a bill of materials."""
