"""What commands and library compute, as values: written by the one, handed on by the other, shown by the report."""
