"""The words by which the gate's comments on proposals are recognised."""

from __future__ import annotations

STALE = "main moved"
WAITS = "Waits for approval"
FIRST_WORDS = ("Refused ", "Closed, ", WAITS)  # how the gate's comments on proposals begin
