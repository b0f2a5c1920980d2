"""Files that people write and read: cell files, tables of other programs, results."""
