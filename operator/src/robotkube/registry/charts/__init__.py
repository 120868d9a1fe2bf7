"""Charts: packing, OCI registry, rendering by helm, schemas of values."""
