"""The standard's own procedure: its phases, its methods for geometry, arm and wrist apart (CWA 17384, 5.2, 7)."""
