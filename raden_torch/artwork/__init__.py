"""What the demonstration shows: a lacquered plate with a motif in raden."""
