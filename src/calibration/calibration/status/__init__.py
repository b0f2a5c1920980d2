"""What is being done, waited for and wrong: the sequencer's part of it, and the whole for panel and terminal."""
