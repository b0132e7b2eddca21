"""Contacts of a sweep, smoothed along it: what neighbouring samples say of one another."""
