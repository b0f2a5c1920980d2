"""A plant of robots: many recordings measured in parallel, their robots seen as draws from the population of a type.

Layers, each importing only those above it: `recordings` (what one says, and what is done); `series`, `pooling`
and `ageing` (numbers alone); `findings`, `reasons` and `plant` (all of them together); `proposals`, `figures` and
`tables` (for people); `next_robot` (what they tell of the next robot of their type).
"""
