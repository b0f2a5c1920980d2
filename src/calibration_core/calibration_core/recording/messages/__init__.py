"""Messages: serialised by a definition, to arrays and back."""
