"""What an identification says, as values."""
