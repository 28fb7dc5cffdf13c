"""The paper line by line, in its own symbols and with its own equation numbers."""
