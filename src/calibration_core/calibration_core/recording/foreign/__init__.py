"""Tables of tracker software and robot controllers: recognised, converted to SI units, joined to readings."""
