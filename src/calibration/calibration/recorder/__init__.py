"""The recorder: every topic of the table to a bag."""
