"""Other people's logs: each reader turns one format into the records of our own."""
