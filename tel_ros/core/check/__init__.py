"""Is this arm what its configuration says? Judgements of recorded states, and pulses that answer the rest."""
