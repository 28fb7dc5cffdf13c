"""The robot's description: where its files are, and the data in them."""
