"""What the panel shows: plain values of the cell's state, put into words for the page and for the terminal."""
