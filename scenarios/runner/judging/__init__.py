"""Judgement of a run by its inputs: metrics, and whether what was expected came true."""
