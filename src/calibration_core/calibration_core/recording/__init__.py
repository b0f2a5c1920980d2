"""Files of recordings to arrays and back: topics and bytes end here."""
