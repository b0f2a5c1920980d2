"""One estimation core: rows, hypotheses about them, sizes by restricted likelihood, proof on blocks left out."""
