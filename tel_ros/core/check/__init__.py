"""Is an arm what its configuration says? Judged by its joint states, and by its response to pulses."""
