"""The version of the package."""

__version__ = "0.1.0"

# Goes up when other random numbers follow from a seed: workers of one run have to agree on it.
SEED_LAYOUT = 1
