"""The sequencer: measures a plan, one run at a time."""
