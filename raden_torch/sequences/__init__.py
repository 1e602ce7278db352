"""Many frames by one command: which they are, what is done with each, and who does it."""
