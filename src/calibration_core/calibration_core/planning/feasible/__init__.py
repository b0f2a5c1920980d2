"""What a cell allows: postures, loads and ways between them."""
