"""Rigid motions, cameras and lines in NumPy, vectorised over leading axes."""
