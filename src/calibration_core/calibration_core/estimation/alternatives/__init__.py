"""Places and forms that a recording cannot tell from those that were accepted, and what they leave open."""
