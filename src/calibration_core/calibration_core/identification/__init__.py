"""From observations and model to an estimate with honest uncertainty."""
