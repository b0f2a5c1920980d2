"""Adapters: drivers' mode and status messages in our own words, one file per make."""
