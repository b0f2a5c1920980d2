"""Recordings, or parts of one, with a set-up each: put together, and identified on what they share."""
