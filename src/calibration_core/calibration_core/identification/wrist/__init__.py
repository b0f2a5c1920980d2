"""The wrist centre point by spheres (CWA 17384, 7.3)."""
