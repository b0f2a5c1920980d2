"""What several commands share: files of a result, the look at the input, arguments."""
