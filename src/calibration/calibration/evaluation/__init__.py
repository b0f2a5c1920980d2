"""The evaluation of recordings, in a process beside the node."""
