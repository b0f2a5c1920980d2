"""Physics beyond the joint springs: one effect is one file."""
