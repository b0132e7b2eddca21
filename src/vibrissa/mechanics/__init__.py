"""The rod's physics, without any object. Lengths in L, forces in EI/L², moments in EI/L (paper, eq.
1).
"""
