"""Contacts smoothed along their sweep: what neighbouring samples say about each other."""
