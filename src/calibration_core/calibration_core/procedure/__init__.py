"""Planning and running a measurement, as pure functions and state machines."""
