"""The theorems of the paper, measured: constants of a practice run, from its trials and networks."""
