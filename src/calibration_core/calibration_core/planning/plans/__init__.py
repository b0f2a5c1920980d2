"""Plans as values and files, for whichever robot they were made, and what is next in them."""
