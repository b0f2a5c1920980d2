"""Effects on absolute positions: geometry, gears, own weight, temperature."""
