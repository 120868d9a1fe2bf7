"""Walks: how many files a reader opens to follow one value through the platform, counted by running the code."""
