"""Storage formats: bytes of files to batches of serialised messages, whole or damaged."""
