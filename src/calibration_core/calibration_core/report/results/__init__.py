"""result.json: what an answer says to programs."""
