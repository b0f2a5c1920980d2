"""Effects of the point chain: what lies between the measured point and its position as recorded."""
