"""Recordings in, of any layout: one reader a format, each to the same two streams; then one
alignment and one judgement for all.
"""
