"""The probe of the preflight: what its pods are, what they say, and what follows from it."""
