"""The effects in the model: which come in, in what sizes, and how likely logs are beside them."""
