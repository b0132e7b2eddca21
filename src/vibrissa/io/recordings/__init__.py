"""Reading recordings of any layout: one reader per format, each producing the same two streams;
alignment and checks are common to all.
"""
