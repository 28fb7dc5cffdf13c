"""Indices over any number of poses or leg lengths, chunk by chunk, resumable."""
