"""The recordings of a plant: which there are, where their files lie, what one says, and what of them is done.

Layers, each importing only those above it: `manifest`, `inputs`, `rows`, `task` (in a worker), `store` (on disk).
"""
