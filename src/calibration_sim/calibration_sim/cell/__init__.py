"""The cell as it is and as it is measured: truth, instruments, protocol, readings and streams."""
