"""What `import calibration_core` offers to Python programs; the commands of the same names do the same.

Every function takes and returns values without files; what comes back is a `Result`, which can be drawn, printed,
turned into a table and saved as the command would have.
"""
