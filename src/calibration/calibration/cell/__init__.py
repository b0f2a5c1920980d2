"""The cell as the sequencer uses it: instruments, loads, recorder, conditions, permission."""
