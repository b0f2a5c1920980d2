"""Whether what comes next may begin, and what the operator is asked where it may not."""

from __future__ import annotations


def why_not(held: bool, paused: bool, permitted: bool, heard: bool) -> str:
    """Return why nothing may begin, as words for the operator; empty if it may.

    Args:
        held: Whether motion has to be resumed by name, for the permission was lost.
        paused: Whether the operator wants a pause.
        permitted: Whether motion is permitted, or none is to begin.
        heard: Whether the guard hears the sequencer, or no motion is to begin.
    """
    if held:
        return "see that it is safe, reset the guard where it is latched, then resume motion with your name"
    if paused:
        return "resume when it is safe to go on"
    if not permitted:
        return "motion is not permitted yet"
    return "" if heard else "the guard does not hear the sequencer yet"
