"""The proof: recordings with concealed effects, a diagnosis that sees the recordings alone, and what came of it."""
