"""What a diagnosis says, as values and in words."""
