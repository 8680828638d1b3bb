"""Learning inverse dynamics from data: arms, movements, recordings, and the learners that are compared."""
