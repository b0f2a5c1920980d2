"""From an estimate to findings: what is missing, where, how sure, and what would decide it."""
