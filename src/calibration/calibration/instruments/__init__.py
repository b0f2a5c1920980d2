"""The instruments: streams checked sample by sample, averages over a settled window."""
